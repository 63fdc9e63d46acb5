"""The service beside other serving frameworks around the same ONNX files and the same requests.

The frameworks share an environment (`make bench` makes it) and run the same bare loop.
"""

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx2
import numpy as np
import psutil

from rollcast import markdown
from tests.bench.harness import Heard, asked, service
from tests.bench.loop import CORES, MAX_BATCH, MODEL, ROOT
from tests.bench.payloads import Kind, frames, payload

CONNECTIONS = (1, 4, 16, 64)
PYTHON = ROOT / ".venv/peers/bin/python"
START_S = 120
PREAMBLE = f"""## Comparison with other frameworks

All frameworks received the same requests (JSON with four PNG files, {MODEL}, 40 steps) from the
same client, and ran the same ONNX files on the same {CORES} cores. Each framework ran a
single-threaded ONNX Runtime on every core and, if it supports batching, batched up to {MAX_BATCH}
waiting requests without waiting for more (`tests/bench/peers`). Request logs were off. The load
alternated between the framework and Rollcast every few seconds, with the other one suspended, so
that drift of the machine affects both. Throughput and p99 are relative to the preceding measurement
of Rollcast: medians of the rounds, with the smallest and the largest value. Rollcast is ahead if
the throughput is below 1 and the p99 above 1. Answers other than 200 count as failures.
"""


@dataclass(frozen=True)
class Peer:
    """Another framework: its name, its program in ``tests/bench/peers``, its payload."""

    name: str
    program: str
    kind: Kind = "json"


PEERS = (
    Peer("plain FastAPI", "plain_fastapi"),
    Peer("LitServe", "lit"),
    Peer("BentoML", "bento", "listed"),
    Peer("Ray Serve", "ray_serve"),
)


@dataclass(frozen=True)
class Load:
    """Answers of a framework and, just before, of Rollcast to the same load."""

    name: str
    connections: int
    theirs: Heard
    ours: Heard


def measure(rounds: int, seconds: float) -> list[Load]:
    """Put every load on every framework and on Rollcast, in turn."""
    found: list[Load] = []
    for peer in PEERS:
        with (
            service(ROLLCAST_INFERENCE_QUEUE="128", ROLLCAST_LOG_REQUESTS="false") as (
                address,
                ours,
            ),
            _running(peer) as (other, its),
        ):
            np.testing.assert_allclose(
                _positions(_first(other, peer.kind)), _positions(_first(address, "json")), atol=1e-2
            )
            for connections in CONNECTIONS:
                load = ("--connections", str(connections))
                # A load before the measured ones: adaptive batching learns from what it sees.
                for measured in (False, *[True] * rounds):
                    with _stopped(its):
                        heard = asked(address, seconds, "json", *load)
                    with _stopped(ours):
                        theirs = asked(other, seconds, peer.kind, *load)
                    if measured:
                        found.append(Load(peer.name, connections, theirs, heard))
    return found


def rows(loads: list[Load]) -> list[str]:
    """Markdown table: one line per framework and number of connections."""
    head = (
        "framework", "connections", "throughput", "rounds", "p99", "rounds", "ahead", "failures",
        "failures of Rollcast",
    )  # fmt: skip
    lines = [markdown.header(head)]
    for name, connections in dict.fromkeys((load.name, load.connections) for load in loads):
        of_both = [load for load in loads if (load.name, load.connections) == (name, connections)]
        rates = [load.theirs.rate / load.ours.rate for load in of_both]
        p99s = [load.theirs.quantile(0.99) / load.ours.quantile(0.99) for load in of_both]
        ahead = np.median(rates) < 1 < np.median(p99s)
        failures = sum(load.theirs.failures for load in of_both)
        our_failures = sum(load.ours.failures for load in of_both)
        shown = "yes" if ahead else "**no**"
        cells = (*_spread(rates), *_spread(p99s), shown, failures, our_failures)
        lines.append(markdown.row((name, connections, *cells)))
    return lines


def _spread(ratios: list[float]) -> tuple[str, str]:
    """Two cells: the median, then the smallest and the largest."""
    return f"{np.median(ratios):.2f}", f"{min(ratios):.2f} .. {max(ratios):.2f}"


@contextmanager
def _stopped(process: psutil.Process) -> Iterator[None]:
    """Suspend a server that gets no requests, because some use a processor even then."""
    every = [process, *process.children(recursive=True)]
    for one in every:
        one.suspend()
    try:
        yield
    finally:
        for one in every:
            one.resume()


@contextmanager
def _running(peer: Peer) -> Iterator[tuple[str, psutil.Process]]:
    """Run a framework's program; yield its address and its process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = f"tests.bench.peers.{peer.program}"
    process = subprocess.Popen(
        ["env", f"PYTHONPATH={ROOT}", PYTHON, "-m", program, str(port)],
        cwd=ROOT,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        _wait(address, peer, process)
        yield address, psutil.Process(process.pid)
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


def _wait(address: str, peer: Peer, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            _first(address, peer.kind)
        except httpx2.HTTPError:
            time.sleep(0.5)
        else:
            return
    raise RuntimeError(f"{peer.name} does not answer; its environment is .venv/peers")


def _first(address: str, kind: Kind) -> Any:
    request = payload(kind, frames())
    answer = httpx2.post(
        f"{address}{request.path}", content=request.body, headers=request.headers, timeout=30
    )
    return answer.raise_for_status().json()


def _positions(answer: Any) -> np.ndarray:
    """Positions [T, 2] of an answer in any framework's format."""
    if isinstance(answer, list):
        answer = answer[0]
    if "objects" in answer:
        return np.array(answer["objects"][0]["positions"])
    return np.array(answer["positions"][0])
