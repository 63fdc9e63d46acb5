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
    "# Several machines",
    "",
    f"The service on Ray Serve (decision 0115), with {REPLICAS} replicas of one logical core each "
    f"on up to {max(NODES)} Ray nodes.",
    f"All nodes share the {CORES} cores of one machine, so the figures show the overhead of "
    "distribution and the effect of",
    f"failures, not the speed-up by more machines. Forecasts of {MODEL} over {HORIZON} steps.",
    "",
]


def fault_lines(faults: Faults) -> list[str]:
    """What clients saw of every fault."""
    lines = [
        "## Faults under load",
        "",
        f"{CLIENTS} clients (`rollcast.client`) send requests without a pause. Latencies include "
        "retries.",
        f"{faults.accepted} requests were accepted, {len(faults.failures)} lost, "
        f"{faults.retried} retried and "
        f"{sum(len(names) > 1 for names in faults.answered_by.values())} answered twice.",
        "The largest difference from a local forecast was "
        f"{max(phase.largest_difference_px for phase in faults.phases):.1g} px.",
        "",
        markdown.header(
            (
                "fault",
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
        "## Overhead of distribution",
        "",
        f"Throughput at {CONNECTIONS} connections and median latency at one connection, relative "
        "to a single service, with",
        f"alternating load on both; medians of {rounds} rounds.",
        "",
        markdown.header(("nodes", "binary tensors", "JSON with PNG files", "latency")),
    ]
    for one in spreads:
        rates = [f"{one.rates[kind]:.2f}" for kind in KINDS]
        lines.append(markdown.row((one.nodes, *rates, f"{one.single:.2f}")))
    return [
        *lines,
        "",
        f"{sum(one.failures for one in spreads)} answers had another status than 200.",
        "",
    ]


def plan_lines(costs: dict[Kind, Cost], spread: Spread, start_s: float) -> list[str]:
    """The plan for a million a second."""
    images = frames()
    sizes = {kind: len(payload(kind, images).body) for kind in KINDS}
    lines = [
        f"## {plan.RATE:,} forecasts per second, calculated",
        "",
        "Resources per forecast of a fully loaded service, and the resources for this rate. The "
        "milliseconds of a stage are the",
        "time that a request spends in it, often in a batch with others.",
        "",
        markdown.header(
            (
                "body",
                "core-ms",
                "decode",
                "encode",
                "rollout",
                "request, bytes",
                "cores at full use",
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
        "The next bottlenecks: decoding PNG files in JSON takes "
        f"{decode_ms:.1f} ms ({decode_ms / encoded.core_ms:.0%} of a forecast's time),",
        f"raw tensors need {sizes['binary'] / sizes['json']:.0f} times the network bandwidth, "
        f"and Ray's proxies and routers use {1 - kept:.0%} of the cores (above, {spread.nodes} "
        "nodes).",
        "Replicas behind a plain load balancer",
        "(`docker/kubernetes/base/rollcast.yaml`) need no such proxies. The remaining time is the "
        "networks' own computation.",
        "",
        f"With Ray, a core answers {per_core:.0f} requests per second. A replica starts within "
        f"{start_s:.0f} s, as measured here. The calculation",
        f"assumes {plan.NODE_START_S} s for the start of a machine, ${plan.CORE_HOUR_USD} per core "
        f"and hour, and a burst of {plan.BURST:g} times the usual requests for "
        f"{plan.BURST_S[1] - plan.BURST_S[0]} s.",
        f"Ray Serve's autoscaling waits {plan.UPSCALE_DELAY_S} s and averages the last "
        f"{plan.LOOK_BACK_S} s. Requests that would wait for more than {plan.WAITING_S:g} s are "
        "rejected.",
        "",
        markdown.header(
            (
                "utilisation",
                "cores",
                "$ per hour",
                "rejected",
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
        f"![Load, replicas and waiting time]({PICTURE.relative_to(PAGE.parent)})",
        "",
    ]


if __name__ == "__main__":
    main()
