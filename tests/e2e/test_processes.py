"""Several processes that answer on one address: what a client may not notice."""

import hashlib
import re
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import httpx2
import numpy as np
import psutil
import pytest

from rollcast.client import Client
from rollcast.manifest import GOLDEN_FILE, MANIFEST_FILE, Manifest
from tests.bench.harness import answering
from tests.e2e.conftest import ROOT, start_service, stop_service, wait_until_ready
from tests.service.samples import body

PROCESSES = 3
MODEL = "posnet"
ASKED = body(horizon=3)

Connect = Callable[[int], list[httpx2.Client]]


class Service:
    """A service of several processes."""

    def __init__(self, **settings: str) -> None:
        self.popen, self.address = start_service(ROLLCAST_PROCESSES=str(PROCESSES), **settings)
        self.process = psutil.Process(self.popen.pid)

    def answering(self) -> list[psutil.Process]:
        return answering(self.process)


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    running = Service()
    with Client(running.address) as client:
        wait_until_ready(client)
    yield running
    assert stop_service(running.popen) == 0
    assert not running.process.is_running()


@pytest.fixture
def connect(service) -> Iterator[Connect]:
    """Make so many clients with a connection each, which has been used."""
    with ExitStack() as stack:

        def clients(count: int) -> list[httpx2.Client]:
            found = [
                stack.enter_context(httpx2.Client(base_url=service.address, timeout=60))
                for _ in range(count)
            ]
            for client in found:
                client.get("/health/live").raise_for_status()
            return found

        yield clients


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def held(process: psutil.Process) -> int:
    return sum(one.status == psutil.CONN_ESTABLISHED for one in process.net_connections("tcp"))


def statuses(clients: list[httpx2.Client]) -> set[str]:
    """Status of a model as each connection tells it."""
    return {client.get(f"/models/{MODEL}/versions/1").json()["status"] for client in clients}


def change(client: httpx2.Client, what: str, name: str = MODEL) -> int:
    return client.post(f"/v2/repository/models/{name}/{what}").status_code


def test_connections_are_shared_out_evenly_and_again_when_some_have_ended(service, connect):
    clients = connect(2 * PROCESSES)
    wait_for(lambda: {held(process) for process in service.answering()} == {2})
    for client in clients[::PROCESSES]:
        client.close()
    wait_for(lambda: sum(map(held, service.answering())) == 2 * PROCESSES - 2)
    connect(2)
    wait_for(lambda: {held(process) for process in service.answering()} == {2})


def test_a_change_of_a_model_is_seen_on_every_connection(connect):
    clients = connect(PROCESSES)
    assert change(clients[0], "unload") == 200
    assert statuses(clients) == {"unloaded"}
    assert change(clients[1], "load") == 200
    assert statuses(clients) == {"ready"}


def test_changes_asked_for_at_once_end_the_same_everywhere(connect):
    clients = connect(PROCESSES)
    with ThreadPoolExecutor(PROCESSES) as pool:
        wanted = ["unload", "load", "unload"]
        assert list(pool.map(change, clients, wanted)) == [200, 200, 200]
    assert len(statuses(clients)) == 1
    assert change(clients[0], "load") == 200


def test_a_change_that_fails_says_so_where_it_was_asked_for(connect):
    clients = connect(PROCESSES)
    for what in ("load", "unload"):
        assert {change(client, what, "nobody") for client in clients} == {404}
    assert change(clients[0], "load") == 200


def test_figures_are_those_of_all_processes(connect):
    clients = connect(PROCESSES)

    def answered() -> float:
        text = clients[0].get("/metrics").text
        pattern = r'^http_requests_total\{handler="/predict",.*status="200"\} (\S+)'
        return sum(map(float, re.findall(pattern, text, re.MULTILINE)))

    before = answered()
    for client in clients:
        client.post("/predict", json=ASKED).raise_for_status()
    assert answered() == before + PROCESSES


def test_one_that_is_killed_is_replaced_and_knows_what_was_changed(service, connect):
    (client,) = connect(1)
    assert change(client, "unload") == 200
    before = service.answering()
    before[0].kill()
    wait_for(lambda: len(set(service.answering()) - set(before)) == 1)
    (new,) = set(service.answering()) - set(before)
    # It gets connections once it can forecast; until then others answer.
    wait_for(lambda: connect(1)[0].post("/predict", json=ASKED).is_success and held(new) > 0)
    clients = connect(2 * PROCESSES)
    assert statuses(clients) == {"unloaded"}
    assert change(clients[0], "load") == 200
    assert statuses(clients) == {"ready"}


def test_what_one_of_them_refuses_none_serves(tmp_path):
    models = tmp_path / "models"
    for name in ("posnet", "dispnet", "fieldnet"):
        folder = models / name / "1"
        shutil.copytree(ROOT / "models" / name / "1", folder)
        with np.load(folder / GOLDEN_FILE) as golden:
            np.savez(folder / GOLDEN_FILE, **{k: v + (k == "positions") for k, v in golden.items()})
        known = Manifest.read(folder / MANIFEST_FILE)
        digest = hashlib.sha256((folder / GOLDEN_FILE).read_bytes()).hexdigest()
        files = {**known.files, GOLDEN_FILE: digest}
        known.model_copy(update={"files": files}).write(folder / MANIFEST_FILE)
    service = Service(ROLLCAST_MODELS_DIR=str(models))
    with Client(service.address) as client:
        wait_until_ready(client)
        assert client.health().status == "no usable model"
    assert stop_service(service.popen) == 0


def test_one_that_dies_before_it_could_forecast_ends_the_service():
    service = Service()
    wait_for(lambda: len(service.answering()) == PROCESSES)
    service.answering()[1].kill()
    service.popen.communicate(timeout=60)
    assert service.popen.returncode not in {0, None}


def test_a_stop_is_heard_at_any_moment_of_the_start():
    for delay in (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.2, 0.5, 1.0):
        service = Service()
        time.sleep(delay)
        assert stop_service(service.popen) in {0, -signal.SIGTERM}


def test_none_outlives_the_one_that_has_started_it():
    service = Service()
    with Client(service.address) as client:
        wait_until_ready(client)
    answering = service.answering()
    service.process.send_signal(signal.SIGKILL)
    service.popen.communicate(timeout=60)
    psutil.wait_procs(answering, 60)
    assert not [process for process in answering if process.is_running()]
