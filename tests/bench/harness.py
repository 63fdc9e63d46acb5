"""What the benchmarks share: the real service, the bare loop, the client, lines of the report."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import psutil

from rollcast.client import Client
from tests.bench.load import Times
from tests.bench.loop import ROOT
from tests.bench.payloads import Kind
from tests.e2e.conftest import start_service, wait_until_ready


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
    command = [sys.executable, "-m", "tests.bench.bare", "--seconds", str(seconds), *options]
    running = [
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        for _ in range(processes)
    ]
    return [json.loads(process.communicate()[0]) for process in running]


def asked(address: str, seconds: float, kind: Kind, *options: str) -> tuple[Times, float]:
    """Times of the service's answers by status, and the client's own share of a core."""
    with asking(address, "--kinds", kind, "--seconds", str(seconds), *options) as answers:
        pass
    times, client_s = answers()
    return times, client_s / seconds


@contextmanager
def asking(address: str, *options: str) -> Iterator[Callable[[], tuple[Times, float]]]:
    """Run the client meanwhile; what is yielded tells afterwards what it saw, and its own time."""
    command = [sys.executable, "-m", "tests.bench.load", address, *options]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    found: list[tuple[Times, float]] = []
    yield lambda: found[0]
    told = json.loads(process.communicate()[0])
    times = {int(status): values for status, values in told["times_s"].items()}
    found.append((times, told["client_s"]))


def median_ms(times: Sequence[float]) -> float:
    return 1e3 * float(np.median(times))
