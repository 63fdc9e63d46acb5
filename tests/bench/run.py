"""Measures the service beside the bare loop in one run, and writes ``docs/benchmarks.md``.

python -m tests.bench.run [--rounds 5] [--seconds 5] [--requests 20000]

Every figure is a ratio or a difference of things that were measured in the same round on the same
cores, one after the other.
"""

import argparse

from rollcast import markdown
from tests.bench import comparison, curve, measures
from tests.bench.harness import service
from tests.bench.loop import CORES, MODEL, ROOT

PAGE = ROOT / "docs" / "benchmarks.md"
PICTURE = ROOT / "docs" / "results" / "batches.png"
PREAMBLE = f"""<!-- Made by `make bench`; do not edit. -->
# Benchmarks

The service with {MODEL} at a horizon of 40 steps, compared with the bare loop
(`tests/bench/bare.py`): the same ONNX files in ONNX Runtime with one thread, without HTTP. Both ran
on the same {CORES} cores, one after the other, in one run. The column "rounds" gives the smallest
and the largest value of all rounds.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--requests", type=int, default=20_000, help="of the memory test")
    given = parser.parse_args()
    findings = [measures.cold_start(given.rounds)]
    with service() as (address, process):
        findings += measures.one_at_a_time(address, given.rounds, given.seconds)
        findings += measures.throughput(address, given.rounds, given.seconds)
        findings += measures.reload(address, 4 * given.seconds)
        findings += measures.memory(address, process, given.requests)
    findings += measures.overload(1, 60)
    table = [markdown.header(("measurement", "median", "rounds", "target", "met"))]
    table += [finding.row() for finding in findings]
    costs = curve.measure(given.seconds)
    curve.draw(costs, PICTURE)
    loads = comparison.measure(given.rounds, given.seconds)
    parts = [
        PREAMBLE,
        *table,
        "",
        comparison.PREAMBLE,
        *comparison.rows(loads),
        "",
        curve.PREAMBLE,
        *curve.rows(costs),
        "",
    ]
    parts += [f"![Time per forecast by batch size]({PICTURE.relative_to(PAGE.parent)})", ""]
    print("\n".join(parts))
    PAGE.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
