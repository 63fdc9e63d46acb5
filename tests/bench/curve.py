"""What a forecast costs in a batch: encoder and rollout at several sizes, on one core and on all.

python -m tests.bench.curve GRAPH --batch 4 --seconds 1

Prints the milliseconds of one forecast of a batch.
"""

import argparse
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from rollcast import markdown
from tests.bench.harness import side_by_side
from tests.bench.loop import CORES, BareLoop
from tests.bench.payloads import frames

Graph = Literal["encoder", "rollout"]
GRAPHS: tuple[Graph, ...] = ("encoder", "rollout")
BATCHES = (1, 2, 4, 8, 16)
PREAMBLE = f"""## Batches

Milliseconds per forecast in a batch, in ONNX Runtime with one thread per process: for one process,
and for as many processes in parallel as there are cores ({CORES}). The scheduler's batch sizes for
encoding frames and for rollouts are based on these figures.
"""


@dataclass(frozen=True)
class Cost:
    """Milliseconds of one forecast of a batch."""

    graph: Graph
    processes: int
    batch: int
    ms: float


def measure(seconds: float) -> list[Cost]:
    """Measure every size on one core and on all."""
    return [
        Cost(graph, processes, batch, _alone_or_beside(graph, batch, processes, seconds / 5))
        for graph in GRAPHS
        for processes in sorted({1, CORES})
        for batch in BATCHES
    ]


def rows(costs: list[Cost]) -> list[str]:
    """Markdown table: a line for every graph and number of processes."""
    lines = [markdown.header(("graph", "processes", *BATCHES))]
    for graph in GRAPHS:
        for processes in sorted({cost.processes for cost in costs}):
            wanted = [c for c in costs if (c.graph, c.processes) == (graph, processes)]
            cells = [f"{cost.ms:.3g}" for cost in wanted]
            lines.append(markdown.row((graph, processes, *cells)))
    return lines


def draw(costs: list[Cost], path: Path) -> None:
    """Draw the cost relative to a batch of one."""
    figure = Figure(figsize=(6, 3.2), layout="constrained")
    axes = figure.subplots()
    for graph, style in zip(GRAPHS, ("-", "--"), strict=True):
        for processes in sorted({cost.processes for cost in costs}):
            wanted = [c for c in costs if (c.graph, c.processes) == (graph, processes)]
            relative = [cost.ms / wanted[0].ms for cost in wanted]
            axes.plot(BATCHES, relative, style, marker="o", label=f"{graph}, {processes} core(s)")
    axes.set_xscale("log", base=2)
    axes.set_xticks(BATCHES, [str(batch) for batch in BATCHES])
    axes.set_ylim(0)
    axes.set_xlabel("forecasts in a batch")
    axes.set_ylabel("time per forecast, batch of one = 1")
    axes.legend()
    figure.savefig(path, metadata={"Software": None})


def _alone_or_beside(graph: Graph, batch: int, processes: int, seconds: float) -> float:
    options = (graph, "--batch", str(batch), "--seconds", str(seconds))
    return float(np.mean(side_by_side(processes, "tests.bench.curve", *options)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("graph", choices=GRAPHS)
    parser.add_argument("--batch", type=int, required=True)
    parser.add_argument("--seconds", type=float, default=1)
    given = parser.parse_args()
    loop = BareLoop()
    images = np.repeat(frames()[None], given.batch, axis=0)
    found = loop.encode(images)
    run = partial(loop.encode, images) if given.graph == "encoder" else partial(loop.roll, found)
    run()
    times: list[float] = []
    end = time.perf_counter() + given.seconds
    while (begun := time.perf_counter()) < end:
        run()
        times.append(time.perf_counter() - begun)
    print(1e3 * float(np.median(times)) / given.batch)


if __name__ == "__main__":
    main()
