"""Measures the service on Ray beside the service alone, and writes ``docs/scaling.md``.

python -m tests.cluster.scaling [--seconds 20] [--calls 1200]
"""

import argparse
import re
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import httpx2
import psutil

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
STAGES = ("decode", "encode", "rollout")


@dataclass(frozen=True)
class Alone:
    """The service on this machine, full: of each forecast, milliseconds of one core."""

    heard: Heard
    single: Heard
    core_ms: float
    stages_ms: dict[str, float]
    """The scheduler's own, of requests that were computed together."""


@dataclass(frozen=True)
class Spread:
    """The service on some nodes."""

    nodes: int
    heard: dict[Kind, Heard]
    single: Heard


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20, help="of every measurement")
    parser.add_argument("--calls", type=int, default=1200, help="in every phase of the faults")
    given = parser.parse_args()
    with service() as (address, process):
        asked_there = questions(address, range(6))
        alone = {kind: full(address, process, given.seconds, kind) for kind in KINDS}
    spreads: list[Spread] = []
    for number in NODES:
        with nodes(number) as running:
            spreads.append(spread(running, number, given.seconds))
            if number == max(NODES):
                start_s = replica_start_s(running)
                load = Load(running.address, asked_there, CLIENTS)
                with tempfile.TemporaryDirectory() as models:
                    faults = suffer(running, load, Path(models), given.calls)
    lines = [
        *PREAMBLE,
        *fault_lines(faults),
        *spread_lines(alone, spreads),
        *plan_lines(alone, start_s),
    ]
    print("\n".join(lines))
    PAGE.write_text("\n".join(lines), encoding="utf-8")


def full(address: str, process: psutil.Process, seconds: float, kind: Kind) -> Alone:
    """Ask with all connections, and with one."""
    single = asked(address, seconds / 2, kind)
    before, stages = process.cpu_times(), stage_sums(address)
    heard = asked(address, seconds, kind, "--connections", str(CONNECTIONS))
    after, later = process.cpu_times(), stage_sums(address)
    used = after.user + after.system - before.user - before.system
    # The client first warms up the service, with answers that are counted here and not there.
    counted = later["count"] - stages["count"]
    sums = {stage: 1e3 * (later[stage] - stages[stage]) / counted for stage in STAGES}
    return Alone(heard, single, 1e3 * used / counted, sums)


def stage_sums(address: str) -> dict[str, float]:
    """Seconds of all stages so far, and the number of forecasts, as Prometheus reads them."""
    text = httpx2.get(f"{address}/metrics").text
    sums = {stage: summed(text, "sum", stage) for stage in STAGES}
    return {**sums, "count": summed(text, "count", "encode")}


def summed(text: str, what: str, stage: str) -> float:
    pattern = rf'^rollcast_stage_seconds_{what}\{{.*stage="{stage}".*\}} (\S+)$'
    return sum(float(value) for value in re.findall(pattern, text, re.MULTILINE))


def spread(running: Nodes, number: int, seconds: float) -> Spread:
    """Ask the proxy of a cluster."""
    with_all = {
        kind: asked(running.address, seconds, kind, "--connections", str(CONNECTIONS))
        for kind in KINDS
    }
    return Spread(number, with_all, asked(running.address, seconds / 2, "binary"))


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
        f"{faults.retried} asked more than once, ",
        f"{sum(len(names) > 1 for names in faults.answered_by.values())} answered twice; every "
        "answer is the checkout's within "
        f"{max(phase.largest_difference_px for phase in faults.phases):.1g} px.",
        "",
        "| meanwhile | answers | p50, ms | p99, ms | longest, ms | versions that answered |",
        "|---|---|---|---|---|---|",
    ]
    for phase in faults.phases:
        versions = ", ".join(map(str, sorted({one.version for one in phase.answers})))
        quantiles = " | ".join(f"{phase.quantile_ms(share):.0f}" for share in (0.5, 0.99, 1))
        lines.append(f"| {phase.name} | {len(phase.answers)} | {quantiles} | {versions} |")
    return [*lines, ""]


def spread_lines(alone: dict[Kind, Alone], spreads: list[Spread]) -> list[str]:
    """What distribution costs."""
    lines = [
        "## What distribution costs",
        "",
        f"Answers a second at {CONNECTIONS} connections, and the median of one request at a time, "
        "relative to the service alone.",
        "",
        "| nodes | binary tensors | JSON with PNG files | one at a time |",
        "|---|---|---|---|",
    ]
    for one in spreads:
        rates = " | ".join(f"{one.heard[kind].rate / alone[kind].heard.rate:.2f}" for kind in KINDS)
        single = one.single.quantile(0.5) / alone["binary"].single.quantile(0.5)
        lines.append(f"| {one.nodes} | {rates} | {single:.2f} |")
    failures = sum(heard.failures for one in spreads for heard in one.heard.values())
    return [*lines, "", f"{failures} answers were not 200.", ""]


def plan_lines(alone: dict[Kind, Alone], start_s: float) -> list[str]:
    """The plan for a million a second."""
    images = frames()
    lines = [
        f"## {plan.RATE:,} forecasts a second, on paper",
        "",
        "What a forecast takes of a full service, and what a million a second would. The "
        "milliseconds of a stage are those",
        "that a request waits for, often together with others.",
        "",
        "| body | core-ms | decode | encode | rollout | request, bytes | cores, all busy | "
        "network in, Gbit/s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, one in alone.items():
        stages = " | ".join(f"{one.stages_ms[stage]:.2f}" for stage in STAGES)
        size = len(payload(kind, images).body)
        lines.append(
            f"| {kind} | {one.core_ms:.2f} | {stages} | {size:,} | "
            f"{plan.RATE * one.core_ms / 1e3:,.0f} | {plan.RATE * size * 8 / 1e9:,.0f} |"
        )
    per_replica = 1e3 / alone["json"].core_ms
    fleets = [plan.simulate(per_replica, start_s, load) for load in plan.LOADS]
    plan.draw(fleets, PICTURE)
    lines += [
        "",
        f"A replica of one core answers {per_replica:.0f} a second and is there {start_s:.0f} s "
        "after it was asked for, as measured here; a machine for it",
        f"is assumed to take {plan.NODE_START_S} s, and a core to cost ${plan.CORE_HOUR_USD} an "
        f"hour. Half as many requests again come for {plan.BURST_S[1] - plan.BURST_S[0]} s; Ray "
        "Serve's autoscaling waits",
        f"{plan.UPSCALE_DELAY_S} s and sees the last {plan.LOOK_BACK_S}; what would wait for more "
        f"than {plan.WAITING_S:g} s is refused.",
        "",
        "| replicas' time that is used | cores | $ an hour | refused of all | longest wait, s |",
        "|---|---|---|---|---|",
    ]
    for fleet in fleets:
        cores = fleet.replicas[0]
        lines.append(
            f"| {fleet.load:.0%} | {cores:,.0f} | {cores * plan.CORE_HOUR_USD:,.0f} | "
            f"{fleet.lost:.1%} | {fleet.wait_s.max():.2f} |"
        )
    return [
        *lines,
        "",
        f"![The crowd, the replicas and the wait]({PICTURE.relative_to(PAGE.parent)})",
        "",
    ]


if __name__ == "__main__":
    main()
