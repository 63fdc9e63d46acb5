"""Measures the service on Ray beside the service alone, and writes ``docs/scaling.md``.

python -m tests.cluster.scaling [--rounds 3] [--seconds 5] [--calls 1200]
"""

import argparse
import re
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import httpx2
import psutil

from rollcast import markdown
from tests.bench.harness import Heard, asked, service
from tests.bench.loop import CORES, HORIZON, MODEL, ROOT
from tests.bench.payloads import Kind, frames, payload
from tests.cluster import plan
from tests.cluster.faults import Faults, suffer
from tests.cluster.load import Load, questions
from tests.cluster.nodes import REPLICAS, Nodes, nodes

PAGE = ROOT / "docs" / "scaling.md"
PICTURE = ROOT / "docs" / "results" / "scaling.png"
NODES = (1, 2, 3)
CONNECTIONS = 16
CLIENTS = 8
KINDS: tuple[Kind, ...] = ("binary", "json")
CORE = "core"
STAGES = ("decode", "encode", "rollout")


@dataclass(frozen=True)
class Cost:
    """What a forecast takes of the service alone, full: milliseconds of one core."""

    core_ms: float
    stages_ms: dict[str, float]
    """What requests wait for each stage, often together."""


@dataclass(frozen=True)
class Spread:
    """The service on some nodes relative to the service alone, measured in turn."""

    nodes: int
    rates: dict[Kind, float]
    """Answers a second with all connections."""
    single: float
    """Median time of one request at a time."""
    failures: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5, help="of every measurement")
    parser.add_argument("--calls", type=int, default=1200, help="in every phase of the faults")
    given = parser.parse_args()
    spreads: list[Spread] = []
    with service() as (address, process):
        asked_there = questions(address, range(6))
        costs = cost(address, process, given.rounds, given.seconds)
        for number in NODES:
            with nodes(number) as running:
                spreads.append(spread(running.address, address, number, given))
                if number == max(NODES):
                    start_s = replica_start_s(running)
                    load = Load(running.address, asked_there, CLIENTS)
                    with tempfile.TemporaryDirectory() as models:
                        faults = suffer(running, load, Path(models), given.calls)
    lines = [
        *PREAMBLE,
        *fault_lines(faults),
        *spread_lines(spreads, given.rounds),
        *plan_lines(costs, spreads[-1], start_s),
    ]
    print("\n".join(lines))
    PAGE.write_text("\n".join(lines), encoding="utf-8")


def cost(address: str, process: psutil.Process, rounds: int, seconds: float) -> dict[Kind, Cost]:
    """Measure what forecasts take, all kinds of body in every round."""
    found: dict[Kind, list[dict[str, float]]] = {kind: [] for kind in KINDS}
    for _ in range(rounds):
        for kind, costs in found.items():
            before, stages = process.cpu_times(), stage_sums(address)
            full(address, seconds, kind)
            after, later = process.cpu_times(), stage_sums(address)
            used = after.user + after.system - before.user - before.system
            spent = {stage: later[stage] - stages[stage] for stage in STAGES} | {CORE: used}
            answers = later["count"] - stages["count"]
            costs.append({name: 1e3 * value / answers for name, value in spent.items()})
    middles = {
        kind: {name: median([one[name] for one in costs]) for name in (CORE, *STAGES)}
        for kind, costs in found.items()
    }
    return {kind: Cost(middle.pop(CORE), middle) for kind, middle in middles.items()}


def full(address: str, seconds: float, kind: Kind) -> Heard:
    """Ask with all connections."""
    return asked(address, seconds, kind, "--connections", str(CONNECTIONS))


def stage_sums(address: str) -> dict[str, float]:
    """Seconds of all stages so far, and the number of forecasts, as Prometheus reads them."""
    text = httpx2.get(f"{address}/metrics").text
    sums = {stage: summed(text, "sum", stage) for stage in STAGES}
    return {**sums, "count": summed(text, "count", "encode")}


def summed(text: str, what: str, stage: str) -> float:
    pattern = rf'^rollcast_stage_seconds_{what}\{{.*stage="{stage}".*\}} (\S+)$'
    return sum(float(value) for value in re.findall(pattern, text, re.MULTILINE))


def spread(cluster: str, alone: str, number: int, given: argparse.Namespace) -> Spread:
    """Ask the proxy of a cluster and the service alone in turn."""
    rates: dict[Kind, list[float]] = {kind: [] for kind in KINDS}
    single: list[float] = []
    failures = 0
    for _ in range(given.rounds):
        for kind, found in rates.items():
            there, here = (full(address, given.seconds, kind) for address in (cluster, alone))
            found.append(there.rate / here.rate)
            failures += there.failures + here.failures
        there, here = (asked(address, given.seconds, "binary") for address in (cluster, alone))
        single.append(there.quantile(0.5) / here.quantile(0.5))
    return Spread(number, {k: median(v) for k, v in rates.items()}, median(single), failures)


def replica_start_s(running: Nodes) -> float:
    """Seconds from the death of a replica until another one has its place."""
    begun = time.monotonic()
    running.replace_replica()
    running.wait_for_replicas()
    return time.monotonic() - begun


PREAMBLE = [
    "<!-- Made by `make scaling`; do not edit. -->",
    "# Past one machine",
    "",
    f"The service on Ray Serve (decision 0115), {REPLICAS} replicas of one logical core each on up "
    f"to {max(NODES)} nodes of Ray,",
    f"all on the same {CORES} cores of one machine: what is shown is what distribution costs and "
    "what faults do, not speed",
    f"by more machines. Forecasts of {MODEL} over {HORIZON} steps.",
    "",
]


def fault_lines(faults: Faults) -> list[str]:
    """What clients saw of every fault."""
    lines = [
        "## Faults under load",
        "",
        f"{CLIENTS} clients (`rollcast.client`) ask without a pause, times include what is asked "
        "again. "
        f"{faults.accepted} requests were accepted, {len(faults.failures)} lost, "
        f"{faults.retried} asked more than once,",
        f"{sum(len(names) > 1 for names in faults.answered_by.values())} answered twice; every "
        "answer is the checkout's within "
        f"{max(phase.largest_difference_px for phase in faults.phases):.1g} px.",
        "",
        markdown.header(
            (
                "meanwhile",
                "answers",
                "p50, ms",
                "p99, ms",
                "longest, ms",
                "versions that answered",
            )
        ),
    ]
    for phase in faults.phases:
        versions = ", ".join(map(str, sorted({one.version for one in phase.answers})))
        quantiles = [f"{phase.quantile_ms(share):.0f}" for share in (0.5, 0.99, 1)]
        lines.append(markdown.row((phase.name, len(phase.answers), *quantiles, versions)))
    return [*lines, ""]


def spread_lines(spreads: list[Spread], rounds: int) -> list[str]:
    """What distribution costs."""
    lines = [
        "## What distribution costs",
        "",
        f"Answers a second at {CONNECTIONS} connections, and the median of one request at a time, "
        "relative to the service alone,",
        f"which was asked in turn; medians of {rounds} rounds.",
        "",
        markdown.header(("nodes", "binary tensors", "JSON with PNG files", "one at a time")),
    ]
    for one in spreads:
        rates = [f"{one.rates[kind]:.2f}" for kind in KINDS]
        lines.append(markdown.row((one.nodes, *rates, f"{one.single:.2f}")))
    return [*lines, "", f"{sum(one.failures for one in spreads)} answers were not 200.", ""]


def plan_lines(costs: dict[Kind, Cost], spread: Spread, start_s: float) -> list[str]:
    """The plan for a million a second."""
    images = frames()
    sizes = {kind: len(payload(kind, images).body) for kind in KINDS}
    lines = [
        f"## {plan.RATE:,} forecasts a second, on paper",
        "",
        "What a forecast takes of a full service, and what a million a second would. The "
        "milliseconds of a stage are those",
        "that a request waits for, often together with others.",
        "",
        markdown.header(
            (
                "body",
                "core-ms",
                "decode",
                "encode",
                "rollout",
                "request, bytes",
                "cores, all busy",
                "network in, Gbit/s",
            )
        ),
    ]
    for kind, one in costs.items():
        stages = [f"{one.stages_ms[stage]:.2f}" for stage in STAGES]
        size = sizes[kind]
        cores, network = plan.RATE * one.core_ms / 1e3, plan.RATE * size * 8 / 1e9
        cells = (f"{one.core_ms:.2f}", *stages, f"{size:,}", f"{cores:,.0f}", f"{network:,.0f}")
        lines.append(markdown.row((kind, *cells)))
    encoded = costs["json"]
    decode_ms = encoded.stages_ms["decode"]
    kept = spread.rates["json"]
    per_core = kept * 1e3 / encoded.core_ms
    fleets = [plan.simulate(per_core, start_s, load) for load in plan.LOADS]
    plan.draw(fleets, PICTURE)
    lines += [
        "",
        "Where the next bottleneck stands: PNG files in JSON take "
        f"{decode_ms:.1f} ms to decode ({decode_ms / encoded.core_ms:.0%} of a forecast's time), "
        f"raw tensors {sizes['binary'] / sizes['json']:.0f} times the network;",
        f"Ray's proxies and routers take {1 - kept:.0%} of the cores (above, {spread.nodes} "
        "nodes). So first the proxies: replicas behind a plain load balancer",
        "(`docker/kubernetes/rollcast.yaml`) do without them. What is left is the networks' own "
        "arithmetic.",
        "",
        f"With Ray, then, a core answers {per_core:.0f} a second. A replica is there "
        f"{start_s:.0f} s after it was asked for, as measured here; a machine for it",
        f"is assumed to take {plan.NODE_START_S} s, and a core to cost ${plan.CORE_HOUR_USD} an "
        f"hour. Half as many requests again come for {plan.BURST_S[1] - plan.BURST_S[0]} s; Ray "
        "Serve's autoscaling waits",
        f"{plan.UPSCALE_DELAY_S} s and sees the last {plan.LOOK_BACK_S}; what would wait for more "
        f"than {plan.WAITING_S:g} s is refused.",
        "",
        markdown.header(
            (
                "cores' time that is used",
                "cores",
                "$ an hour",
                "refused of all",
                "longest wait, s",
            )
        ),
    ]
    for fleet in fleets:
        cores = fleet.replicas[0]
        cost = cores * plan.CORE_HOUR_USD
        refused, wait = f"{fleet.lost:.1%}", f"{fleet.wait_s.max():.2f}"
        lines.append(
            markdown.row((f"{fleet.load:.0%}", f"{cores:,.0f}", f"{cost:,.0f}", refused, wait))
        )
    return [
        *lines,
        "",
        f"![The crowd, the replicas and the wait]({PICTURE.relative_to(PAGE.parent)})",
        "",
    ]


if __name__ == "__main__":
    main()
