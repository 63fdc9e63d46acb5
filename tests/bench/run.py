"""Measures the service beside the bare loop in one run, and writes ``docs/benchmarks.md``.

python -m tests.bench.run [--rounds 5] [--seconds 5]

Every figure is a ratio or a difference of things that were measured in the same round on the same
cores, one after the other.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from rollcast.client import Client
from tests.bench.load import Times
from tests.bench.payloads import Kind
from tests.e2e.conftest import start_service, wait_until_ready

ROOT = Path(__file__).resolve().parents[2]
MODEL = "fieldnet"
CORES = len(os.sched_getaffinity(0))
PAGE = ROOT / "docs" / "benchmarks.md"
PREAMBLE = f"""<!-- Made by `make bench`; do not edit. -->
# Benchmarks

The service with {MODEL} at a horizon of 40 steps beside the bare loop (`tests/bench/bare.py`): the
same ONNX files in ONNX Runtime, one thread, nothing around them. One run on the same {CORES} cores,
one after the other; "rounds" are the smallest and the largest of the rounds' figures.

"""


@dataclass(frozen=True)
class Finding:
    """One line of the report: a figure of every round, and what is promised of its median."""

    what: str
    unit: str
    rounds: tuple[float, ...]
    promise: str
    kept: Callable[[float], bool]

    def row(self) -> str:
        """Markdown."""
        middle = float(np.median(self.rounds))
        spread = f"{min(self.rounds):.2f} .. {max(self.rounds):.2f}"
        kept = "yes" if self.kept(middle) else "**no**"
        return f"| {self.what} | {middle:.2f} {self.unit} | {spread} | {self.promise} | {kept} |"


@contextmanager
def service(**settings: str) -> Iterator[tuple[str, psutil.Process]]:
    """Run the real service; yield its address and its process."""
    process, address = start_service(**settings)
    with Client(address) as client:
        wait_until_ready(client)
    yield address, psutil.Process(process.pid)
    process.send_signal(signal.SIGTERM)
    process.wait(60)


def bare(seconds: float, *options: str, processes: int = 1) -> list[list[float]]:
    """Times of the bare loop's forecasts, of every process."""
    command = [sys.executable, "-m", "tests.bench.bare", MODEL, "--seconds", str(seconds), *options]
    running = [
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        for _ in range(processes)
    ]
    return [json.loads(process.communicate()[0]) for process in running]


def asked(address: str, seconds: float, kind: Kind, *options: str) -> tuple[Times, float]:
    """Times of the service's answers by status, and the client's own share of a core."""
    command = [sys.executable, "-m", "tests.bench.load", address, MODEL, "--kind", kind]
    command += ["--seconds", str(seconds), *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    times = {int(status): values for status, values in found["times_s"].items()}
    return times, found["client_s"] / seconds


def median_ms(times: Sequence[float]) -> float:
    return 1e3 * float(np.median(times))


def one_at_a_time(address: str, rounds: int, seconds: float) -> list[Finding]:
    """Difference of medians over HTTP and in the bare loop."""
    over: dict[Kind, list[float]] = {"binary": [], "multipart": [], "json": []}
    for _ in range(rounds):
        plain, decoding = (median_ms(bare(seconds, *options)[0]) for options in ([], ["--decode"]))
        for kind, found in over.items():
            times, _ = asked(address, seconds, kind)
            assert set(times) == {200}, times.keys()
            found.append(median_ms(times[200]) - (plain if kind == "binary" else decoding))
    limits: dict[Kind, float] = {"binary": 2.5, "multipart": 3, "json": 3}
    return [
        Finding(
            f"one at a time, {kind}: p50 beyond the bare loop's"
            + ("" if kind == "binary" else ", which decodes too"),
            "ms", tuple(found), f"at most {limits[kind]:g}", lambda x, most=limits[kind]: x <= most,
        )
        for kind, found in over.items()
    ]  # fmt: skip


def throughput(address: str, rounds: int, seconds: float) -> list[Finding]:
    """Answers a second at 16 connections relative to the bare loop on every core."""
    shares: dict[Kind, list[float]] = {"binary": [], "multipart": []}
    own: list[float] = []
    for _ in range(rounds):
        alone = sum(len(times) for times in bare(seconds, processes=CORES))
        for kind, found in shares.items():
            times, client = asked(address, seconds, kind, "--connections", "16")
            assert set(times) == {200}, times.keys()
            found.append(len(times[200]) / alone)
            own.append(client)
    findings = [
        Finding(
            f"16 connections, {kind}: answers relative to the bare loop on {CORES} cores", "",
            tuple(found), f"at least {least:g}", lambda x, least=least: x >= least,
        )
        for (kind, found), least in zip(shares.items(), (0.85, 0.75), strict=True)
    ]  # fmt: skip
    told = Finding("the client's own share of a core", "", tuple(own), "told", lambda _: True)
    return [*findings, told]


def overload(rounds: int, seconds: float) -> list[Finding]:
    """Twice as many requests as can be answered."""
    with service(ROLLCAST_INFERENCE_QUEUE="4") as (address, _):
        slower: list[float] = []
        after: list[float] = []
        for _ in range(rounds):
            quiet, _ = asked(address, seconds / 4, "binary")
            full, _ = asked(address, seconds / 4, "binary", "--connections", str(CORES))
            rate = 2 * len(full[200]) / (seconds / 4)
            loaded, _ = asked(address, seconds, "binary", "--rate", str(rate))
            assert set(loaded) == {200, 429}, loaded.keys()
            again, _ = asked(address, seconds / 4, "binary")
            p99 = np.quantile(quiet[200], 0.99)
            slower.append(float(np.quantile(loaded[200], 0.99) / p99))
            after.append(float(np.median(again[200]) / np.median(quiet[200])))
    return [
        Finding(
            "twice the capacity: p99 of accepted requests relative to the unloaded p99", "",
            tuple(slower), "at most 3", lambda x: x <= 3,
        ),
        Finding(
            "afterwards: p50 relative to before", "", tuple(after), "about 1", lambda x: x < 1.1
        ),
    ]  # fmt: skip


def cold_start(rounds: int) -> Finding:
    """Seconds from the start of the process to readiness."""
    found: list[float] = []
    for _ in range(rounds):
        begun = time.perf_counter()
        with service():
            found.append(time.perf_counter() - begun)
    return Finding(
        "cold start to ready, all models", "s", tuple(found), "under 2.5", lambda x: x < 2.5
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5)
    given = parser.parse_args()
    findings = [cold_start(given.rounds)]
    with service() as (address, _):
        findings += one_at_a_time(address, given.rounds, given.seconds)
        findings += throughput(address, given.rounds, given.seconds)
    findings += overload(1, 60)
    table = ["| what | median | rounds | promised | kept |", "|---|---|---|---|---|"]
    table += [finding.row() for finding in findings]
    print("\n".join(table))
    PAGE.write_text(PREAMBLE + "\n".join(table) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
