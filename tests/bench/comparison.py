"""The service beside other serving frameworks around the same ONNX files and the same requests.

Each framework has an environment of its own (`make bench` builds them) and runs the same bare loop.
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

from tests.bench.harness import Heard, asked, service
from tests.bench.loop import CORES, MAX_BATCH, MODEL, ROOT
from tests.bench.payloads import Kind, frames, payload

CONNECTIONS = (1, 4, 16, 64)
START_S = 120
OURS = "Rollcast"
PREAMBLE = f"""## Beside other frameworks

The same requests (JSON with four PNG files, {MODEL}, 40 steps), the same ONNX files, the same
{CORES} cores and the same client, one framework after the other in every round. Each runs a
single-threaded ONNX Runtime on every core and, where it has batching, batches of up to
{MAX_BATCH} of what waits, without waiting for more (`tests/bench/peers`). Answers a second and
p99 relative to Rollcast's in the same round, medians of the rounds: Rollcast is ahead where the
first is under 1 and the second over 1. Answers that are not 200 are failures.
"""


@dataclass(frozen=True)
class Peer:
    """Another framework: its name, its program in ``tests/bench/peers``, its environment."""

    name: str
    program: str
    environment: str
    kind: Kind = "json"


PEERS = (
    Peer("plain FastAPI", "plain_fastapi", "peer-fastapi"),
    Peer("LitServe", "lit", "peer-litserve"),
    Peer("BentoML", "bento", "peer-bentoml", "listed"),
    Peer("Ray Serve", "ray_serve", "peer-ray"),
)


@dataclass(frozen=True)
class Load:
    """What a client heard of a framework."""

    name: str
    connections: int
    heard: Heard


def measure(rounds: int, seconds: float) -> list[Load]:
    """Put every load on every framework, in rounds."""
    found: list[Load] = []
    for _ in range(rounds):
        with service(ROLLCAST_INFERENCE_QUEUE="128") as (address, _):
            expected = _positions(_first(address, "json"))
            found += _loads(OURS, address, "json", seconds)
        for peer in PEERS:
            with _running(peer) as address:
                positions = _positions(_first(address, peer.kind))
                np.testing.assert_allclose(positions, expected, atol=1e-2)
                found += _loads(peer.name, address, peer.kind, seconds)
    return found


def rows(loads: list[Load]) -> list[str]:
    """Markdown table: a line a framework, two columns a number of connections."""
    heads = [f"{what}, {c}" for c in CONNECTIONS for what in ("answers", "p99")]
    lines = [f"| framework | {' | '.join(heads)} | failures |", "|---" * (len(heads) + 2) + "|"]
    for name in dict.fromkeys(load.name for load in loads if load.name != OURS):
        cells = [
            f"{ratio:.2f}"
            for connections in CONNECTIONS
            for ratio in _ratios(loads, name, connections)
        ]
        failures = sum(load.heard.failures for load in loads if load.name == name)
        lines.append(f"| {name} | {' | '.join(cells)} | {failures} |")
    failures = sum(load.heard.failures for load in loads if load.name == OURS)
    lines.append(f"| {OURS} {'| 1 ' * len(heads)}| {failures} |")
    return lines


def _ratios(loads: list[Load], name: str, connections: int) -> tuple[float, float]:
    """Answers and p99 relative to ours, medians of the rounds."""
    theirs = [one for one in loads if (one.name, one.connections) == (name, connections)]
    ours = [one for one in loads if (one.name, one.connections) == (OURS, connections)]
    pairs = list(zip(theirs, ours, strict=True))
    rates = [one.heard.rate / other.heard.rate for one, other in pairs]
    p99s = [one.heard.quantile(0.99) / other.heard.quantile(0.99) for one, other in pairs]
    return float(np.median(rates)), float(np.median(p99s))


def _loads(name: str, address: str, kind: Kind, seconds: float) -> list[Load]:
    found: list[Load] = []
    for connections in CONNECTIONS:
        # A load before the measured one: adaptive batching learns from what it sees.
        asked(address, seconds / 2, kind, "--connections", str(connections))
        found.append(
            Load(
                name,
                connections,
                asked(address, seconds, kind, "--connections", str(connections)),
            )
        )
    return found


@contextmanager
def _running(peer: Peer) -> Iterator[str]:
    """Run a framework's program; yield its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    python = ROOT / ".venv" / peer.environment / "bin" / "python"
    program = f"tests.bench.peers.{peer.program}"
    process = subprocess.Popen(
        ["env", f"PYTHONPATH={ROOT}", python, "-m", program, str(port)],
        cwd=ROOT,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        _wait(address, peer, process)
        yield address
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
    raise RuntimeError(f"{peer.name} does not answer; its environment is .venv/{peer.environment}")


def _first(address: str, kind: Kind) -> Any:
    request = payload(kind, frames())
    answer = httpx2.post(
        f"{address}{request.path}", content=request.body, headers=request.headers, timeout=30
    )
    return answer.raise_for_status().json()


def _positions(answer: Any) -> np.ndarray:
    """Positions [T, 2] in whichever form they are answered."""
    if isinstance(answer, list):
        answer = answer[0]
    if "objects" in answer:
        return np.array(answer["objects"][0]["positions"])
    return np.array(answer["positions"][0])
