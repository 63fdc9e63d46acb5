"""Several worker processes on one address: clients do not notice how many there are."""

import hashlib
import shutil
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import httpx2
import numpy as np
import psutil
import pytest

from rollcast.client import Client
from rollcast.manifest import GOLDEN_FILE, MANIFEST_FILE, Manifest
from tests.e2e.conftest import ROOT, stop_service, wait_until_ready
from tests.e2e.workers import MODEL, Service, change, connect_to_each, statuses, wait_for
from tests.service.samples import body

PROCESSES = 2
ASKED = body(horizon=3, model=MODEL)


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with Service(PROCESSES, only=MODEL) as running:
        yield running


@pytest.fixture
def clients(service) -> Iterator[list[httpx2.Client]]:
    """A client with a connection to each worker."""
    with ExitStack() as stack:
        yield connect_to_each(service, stack)


def test_a_change_of_a_model_reaches_every_worker(clients):
    assert change(clients[0], "unload") == 200
    assert clients[0].get(f"/models/{MODEL}").json()["status"] == "unloaded"
    wait_for(lambda: statuses(clients) == {"unloaded"})
    assert change(clients[1], "load") == 200
    assert clients[1].get(f"/models/{MODEL}").json()["status"] == "ready"
    wait_for(lambda: statuses(clients) == {"ready"})


def test_changes_asked_for_at_once_end_the_same_everywhere(clients):
    with ThreadPoolExecutor(4) as pool:
        asked = list(pool.map(change, clients * 2, ["unload", "load", "load", "unload"]))
    assert asked == [200] * 4
    # The last one is in the file: what all workers have once they have read it.
    assert change(clients[0], "load") == 200
    wait_for(lambda: statuses(clients) == {"ready"})
    time.sleep(1)
    assert statuses(clients) == {"ready"}


def test_a_change_that_fails_says_so_and_is_not_recorded(service, clients):
    for what in ("load", "unload"):
        assert {change(client, what, "nobody") for client in clients} == {404}
    assert change(clients[0], "load") == 200
    assert "nobody" not in service.recorded_changes()


def test_metrics_are_those_of_all_workers(service, clients):
    name = r'http_requests_total\{handler="/predict",.*status="200"\}'
    before = sum(service.metric(name))
    for client in clients:
        client.post("/predict", json=ASKED).raise_for_status()
    assert sum(service.metric(name)) == before + PROCESSES


def test_a_model_that_fails_its_proof_is_served_by_no_worker(tmp_path):
    models = tmp_path / "models"
    for name in ("posnet", "fieldnet"):
        folder = models / name / "1"
        shutil.copytree(ROOT / "models" / name / "1", folder)
        with np.load(folder / GOLDEN_FILE) as golden:
            np.savez(folder / GOLDEN_FILE, **{k: v + (k == "positions") for k, v in golden.items()})
        known = Manifest.read(folder / MANIFEST_FILE)
        digest = hashlib.sha256((folder / GOLDEN_FILE).read_bytes()).hexdigest()
        files = {**known.files, GOLDEN_FILE: digest}
        known.model_copy(update={"files": files}).write(folder / MANIFEST_FILE)
    with (
        Service(PROCESSES, ROLLCAST_MODELS_DIR=str(models)) as service,
        Client(service.address) as client,
    ):
        wait_until_ready(client)
        assert client.health().status == "no usable model"


def test_a_worker_that_dies_before_any_has_served_ends_the_service():
    with Service(PROCESSES, wait=False) as service:
        wait_for(lambda: len(service.workers()) == PROCESSES)
        service.workers()[1].kill()
        service.popen.communicate(timeout=60)
        assert service.popen.returncode not in {0, None}
        assert "before it served" in service.log()


def test_a_stop_is_heard_at_any_moment_of_the_start():
    for delay in (0.0, 0.01, 0.1, 0.5, 1.0, 2.0):
        with Service(PROCESSES, wait=False) as service:
            time.sleep(delay)
            assert stop_service(service.popen) in {0, -signal.SIGTERM}


def test_no_worker_outlives_its_supervisor():
    with Service(PROCESSES, only=MODEL) as service:
        workers = service.workers()
        service.process.send_signal(signal.SIGKILL)
        service.popen.communicate(timeout=60)
        _, left = psutil.wait_procs(workers, 60)
        assert not left
        assert not list(Path("/dev/shm").glob(f"rollcast-*/counter_{service.popen.pid}.db"))
