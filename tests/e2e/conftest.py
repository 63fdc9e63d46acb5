"""The real server as a process of its own, with the committed models."""

import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import httpx2
import numpy as np
import pytest

from rollcast.client import Client

ROOT = Path(__file__).resolve().parents[2]
SERVICE_PYTHON = ROOT / ".venv/service/bin/python"
"""What `make serve` runs: the environment without torch."""


def start_service(
    log: IO[str] | int = subprocess.DEVNULL,
    command: Sequence[str | Path] = (SERVICE_PYTHON, "-m", "service"),
    prefix: Sequence[str] = (),
    **settings: str,
) -> tuple[subprocess.Popen[str], str]:
    """Start the service on a free port, behind a command that runs it; return process, address."""
    variables = [f"{name}={value}" for name, value in settings.items()]
    process = subprocess.Popen(
        [*prefix, "env", *variables, *command, "--port", "0"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
    )
    assert process.stdout is not None
    return process, said_address(process.stdout)


def said_address(output: IO[str]) -> str:
    """Return the address that a service says when it begins to listen."""
    line = output.readline()
    found = re.search(r"http://\S+", line)
    assert found, f"the service said {line!r}"
    return found.group()


def stop_service(process: subprocess.Popen[str]) -> int:
    process.terminate()
    process.communicate(timeout=30)
    return process.returncode


def wait_until_ready(client: Client) -> None:
    deadline = time.monotonic() + 60
    while client.health().status == "loading":
        assert time.monotonic() < deadline
        time.sleep(0.05)


def held(address: str) -> int:
    """Forecasts that run or wait."""
    text = httpx2.get(f"{address}/metrics").text
    found = re.search(r'^rollcast_requests_in_flight\{pool="inference"\} (\S+)', text, re.MULTILINE)
    assert found
    return int(float(found.group(1)))


@contextmanager
def long_forecasts(address: str, count: int) -> Iterator[list[Future[int]]]:
    """Ask for forecasts of LONGEST_HORIZON steps; yield their numbers of steps once all are held.

    They are asked for at one moment, and again if some have ended before the last was held.
    """
    with ExitStack() as stack:
        clients = [stack.enter_context(Client(address)) for _ in range(count)]
        frames = clients[0].simulate("hemisphere", seed=1, steps=4).frames
        for client in clients:
            client.health()  # from now on its connection is open
        threads = stack.enter_context(ThreadPoolExecutor(count))

        def forecast(client: Client, together: threading.Barrier) -> int:
            together.wait()
            return len(client.predict(frames, model="dispnet", horizon=LONGEST_HORIZON).times_s)

        for _ in range(5):
            together = threading.Barrier(count)
            answers = [threads.submit(forecast, client, together) for client in clients]
            while not all(answer.done() for answer in answers):
                if held(address) == count:
                    yield answers
                    return
        raise AssertionError(f"{count} forecasts were never held at one moment")


def assert_same_forecasts(address: str, other: str, asked: dict[str, object]) -> None:
    """Ask two services for a scene and its forecast, up to what the model was trained to."""
    about = {name: value for name, value in asked.items() if name != "model"}
    with Client(address) as one, Client(other) as another:
        scene, same = (client.simulate(**about, seed=7, steps=8) for client in (one, another))
        np.testing.assert_array_equal(scene.frames, same.frames)
        trained = another.predict(scene.frames[:4], **asked).model.trained_horizon
        forecasts = [
            client.predict(scene.frames[:4], horizon=trained, **asked) for client in (one, another)
        ]
    assert forecasts[0].model == forecasts[1].model
    np.testing.assert_allclose(forecasts[0].positions, forecasts[1].positions, rtol=0, atol=1e-2)


ASKED = [
    {"model": "auto", "scenario": "hemisphere", "num_objects": 1},
    {"model": "posnet", "scenario": "heightfield", "num_objects": 1},
    {"model": "auto", "scenario": "ellipsoid", "num_objects": 2},
]
"""Forecasts that are the same wherever the service runs."""


LONGEST_HORIZON = 1000


@contextmanager
def serving(**settings: str) -> Iterator[str]:
    """Run the service until it is no longer needed; yield its address once it is ready."""
    process, address = start_service(**settings)
    with Client(address) as client:
        wait_until_ready(client)
    yield address
    assert stop_service(process) in {0, -signal.SIGTERM}


@pytest.fixture(scope="session")
def address(request) -> Iterator[str]:
    if (given := request.config.getoption("--address")) is not None:
        yield given
        return
    with serving() as address:
        yield address


@pytest.fixture
def client(address: str) -> Iterator[Client]:
    with Client(address) as client:
        yield client
