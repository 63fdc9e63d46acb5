"""What the benchmarks share: the real service, the bare loop, the client, lines of the report."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil

from rollcast import markdown
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
        return markdown.row((self.what, f"{middle:.2f} {self.unit}", spread, self.promise, kept))


@contextmanager
def service(**settings: str) -> Iterator[tuple[str, psutil.Process]]:
    """Run the real service; yield its address and its process."""
    process, address = start_service(**settings)
    with Client(address) as client:
        wait_until_ready(client)
    yield address, psutil.Process(process.pid)
    process.send_signal(signal.SIGTERM)
    process.wait(60)


def answering(process: psutil.Process) -> list[psutil.Process]:
    """The processes of a service that accept connections: its worker processes, or itself."""
    found: list[psutil.Process] = []
    for child in process.children():
        with suppress(psutil.NoSuchProcess):  # one that has just died has no connections
            listens = any(one.status == "LISTEN" for one in child.net_connections("tcp"))
            found += [child] if listens else []
    return found or [process]


def bare(seconds: float, *options: str, processes: int = 1) -> list[list[float]]:
    """Times of the bare loop's forecasts, of every process."""
    return side_by_side(processes, "tests.bench.bare", "--seconds", str(seconds), *options)


def side_by_side(processes: int, program: str, *options: str) -> list[Any]:
    """Run so many processes of a program at once; return what each printed, JSON."""
    command = [sys.executable, "-m", program, *options]
    running = [
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        for _ in range(processes)
    ]
    return [json.loads(process.communicate()[0]) for process in running]


@dataclass(frozen=True)
class Heard:
    """What a client heard: times of answers by status, time until the last one, its own time."""

    times: Times
    wall_s: float
    client_s: float

    @property
    def rate(self) -> float:
        """Answers a second."""
        return len(self.times.get(200, [])) / self.wall_s

    @property
    def failures(self) -> int:
        """Answers that are not 200."""
        return sum(len(times) for status, times in self.times.items() if status != 200)

    def quantile(self, share: float) -> float:
        """Seconds within which such a share of the answers came."""
        return float(np.quantile(self.times.get(200, [np.inf]), share))


def ask(address: str, *options: str) -> subprocess.Popen[str]:
    """Start the client; :func:`heard` waits for it."""
    command = [sys.executable, "-m", "tests.bench.load", address, *options]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def heard(client: subprocess.Popen[str]) -> Heard:
    """Wait for a client to end; return what it heard."""
    told = json.loads(client.communicate()[0])
    times = {int(status): values for status, values in told["times_s"].items()}
    return Heard(times, told["wall_s"], told["client_s"])


def asked(address: str, seconds: float, kind: Kind, *options: str) -> Heard:
    """Run the client for some seconds; return what it heard."""
    return heard(ask(address, "--kinds", kind, "--seconds", str(seconds), *options))


def median_ms(times: Sequence[float]) -> float:
    return 1e3 * float(np.median(times))
