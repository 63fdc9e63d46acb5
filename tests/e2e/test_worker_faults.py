"""What a service does with processes that die, stop or cannot start, and with disks that are full.

Every service here is stopped at the end of its test, in the state that the test leaves it in: that
takes no longer than its stop timeout and a margin (``tests.e2e.workers.Service``).
"""

import os
import shutil
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import httpx2
import psutil
import pytest

from rollcast.client import Client
from rollcast.manifest import MANIFEST_FILE
from tests.e2e.conftest import ROOT, wait_until_ready
from tests.e2e.workers import MODEL, Service, change, connect_to_each, statuses, wait_for
from tests.service.samples import body

ASKED = body(model=MODEL, horizon=3)
SIMULATION = {"scenario": "hemisphere", "seed": 1, "steps": 4}
LONG_NAME = 60_000
REPLACED_S = 120
"""Until a worker that does not respond is replaced and has its models, on a busy machine."""


def predict(service: Service) -> httpx2.Response:
    """Ask on a connection of its own."""
    return httpx2.post(f"{service.address}/predict", json=ASKED, timeout=60)


def restarts(service: Service, reason: str) -> float:
    """Workers that were replaced for a reason."""
    (count,) = service.metric(rf'rollcast_worker_restarts_total\{{reason="{reason}"\}}')
    return count


def test_a_killed_worker_is_replaced_and_has_the_models_of_the_others():
    with Service(2) as service, ExitStack() as stack:
        before = connect_to_each(service, stack)
        assert change(before[0], "unload") == 200
        assert restarts(service, "exited") == 0
        killed, other = service.workers()
        killed.kill()
        wait_for(lambda: killed.pid not in {one.pid for one in service.workers()})
        # Connections go to the other worker until the new one has its models. It follows the change
        # of models within a poll of its file.
        wait_for(lambda: predict(service).status_code == 503)
        wait_for(lambda: len(service.workers()) == 2)
        after = connect_to_each(service, stack)
        wait_for(lambda: statuses(after) == {"unloaded"})
        assert change(after[0], "load") == 200
        wait_for(lambda: statuses(after) == {"ready"})
        assert predict(service).status_code == 200
        assert restarts(service, "exited") == 1
        assert restarts(service, "unresponsive") == 0
        assert f"worker {killed.pid} exited with -9; replaced by" in service.log()
        assert other.pid in {one.pid for one in service.workers()}


def test_a_worker_that_ends_before_it_served_is_replaced_beside_one_that_serves():
    with Service(2, wait=False, only=MODEL) as service:

        def started() -> list[psutil.Process]:
            children = service.process.children()
            return [child for child in children if "spawn_main" in " ".join(child.cmdline())]

        wait_for(lambda: len(started()) == 2)
        first = min(started(), key=lambda child: child.pid)
        # Whatever the workers do meanwhile, the supervisor finds at once.
        first.suspend()
        service.process.suspend()
        live = httpx2.get(f"{service.address}/health/live", timeout=60)  # from the other worker
        assert live.status_code == 200
        first.kill()
        service.process.resume()
        wait_for(lambda: restarts(service, "exited") == 1)
        wait_for(lambda: len(service.workers()) == 2)


def test_a_stopped_worker_is_noticed_and_replaced():
    with Service(2, only=MODEL) as service, ExitStack() as stack:
        connect_to_each(service, stack)  # a worker that has not yet served has two minutes
        stopped = service.workers()[0]
        stopped.send_signal(signal.SIGSTOP)
        wait_for(lambda: not stopped.is_running(), REPLACED_S)
        wait_for(lambda: len(service.workers()) == 2, REPLACED_S)
        assert predict(service).status_code == 200
        assert restarts(service, "unresponsive") == 1
        assert f"worker {stopped.pid} did not answer a ping; replaced by" in service.log()


@pytest.mark.parametrize("stopped", [1, 2])
def test_sigterm_ends_a_service_whose_workers_are_stopped(stopped):
    with Service(2, only=MODEL) as service:
        for worker in service.workers()[:stopped]:
            worker.send_signal(signal.SIGSTOP)
        service.stop()


def test_sigterm_ends_a_service_whose_worker_stopped_while_it_started():
    with Service(2, wait=False, only=MODEL) as service:
        wait_for(lambda: bool(service.workers()))
        service.workers()[0].send_signal(signal.SIGSTOP)
        service.stop()


def test_a_second_signal_ends_the_wait_for_answers():
    with Service(
        2,
        only=MODEL,
        ROLLCAST_SHUTDOWN_DELAY_S="60",
        ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S="60",
    ) as service:
        begun = time.monotonic()
        service.popen.terminate()
        time.sleep(1)
        assert service.popen.poll() is None
        service.popen.terminate()
        service.popen.communicate(timeout=60)
        assert time.monotonic() - begun < 30


@pytest.mark.parametrize("processes", [1, 2])
def test_requests_with_long_names_cost_a_short_answer(processes):
    with Service(processes, only=MODEL) as service:
        workers = service.workers()
        names = [chr(ord("a") + index % 26) * LONG_NAME for index in range(60)]

        def ask(name: str) -> httpx2.Response:
            with httpx2.Client(base_url=service.address, timeout=60) as client:
                return client.post(f"/v2/repository/models/{name}/load")

        with ThreadPoolExecutor(24) as pool:
            asked = [pool.submit(ask, name) for name in names]
            while not all(one.done() for one in asked):
                live = httpx2.get(f"{service.address}/health/live", timeout=60)
                assert live.json() == {"status": "live"}
        answers = [one.result() for one in asked]
        assert {answer.status_code for answer in answers} == {404}
        assert max(len(answer.content) for answer in answers) < 1000
        assert service.workers() == workers
        assert predict(service).status_code == 200
        assert "aaaaa" not in service.metrics()
        assert max(map(len, service.log().splitlines())) < 5000
        if processes > 1:
            assert service.recorded_changes() == {}


@pytest.mark.parametrize("processes", [1, 2])
def test_broken_models_leave_a_service_that_says_so(processes, tmp_path):
    models = tmp_path / "models"
    for name in ("posnet", "dispnet"):
        shutil.copytree(ROOT / "models" / name, models / name)
    manifest = models / "posnet" / "1" / MANIFEST_FILE
    manifest.unlink()
    os.mkfifo(manifest)
    (models / "dispnet" / "1" / "rollout.onnx").write_bytes(b"no graph")
    with (
        Service(processes, ROLLCAST_MODELS_DIR=str(models)) as service,
        httpx2.Client(base_url=service.address, timeout=60) as client,
    ):
        assert client.get("/health/live").json() == {"status": "live"}
        assert client.get("/health/ready").json() == {"status": "no usable model"}
        index = client.post("/v2/repository/index").json()
        reasons = {entry["name"]: entry["reason"] for entry in index}
        assert reasons["posnet"] == "manifest.json is not a regular file"
        assert reasons["dispnet"].startswith("rollout.onnx is not the file that the manifest names")


@pytest.mark.parametrize("processes", [1, 2])
def test_a_full_disk_ends_no_process(processes):
    # The workers' files take their room at the start; then nothing is left.
    with Service(processes, prefix=own_disks("16m", "64k")) as service:
        workers = service.workers()
        pid = service.popen.pid
        inside = ["nsenter", "--mount", f"--target={pid}", "sh", "-c"]
        for disk in ("/dev/shm", "/tmp"):
            subprocess.run([*inside, f"cat /dev/zero > {disk}/filler"], stderr=subprocess.DEVNULL)
        with httpx2.Client(base_url=service.address, timeout=60) as client:
            for model in ("auto", MODEL, "dispnet", "fieldnet"):
                answer = client.post("/predict", json=body(model=model, horizon=3))
                assert answer.status_code == 200
            simulated = client.post("/simulate", json=SIMULATION)
            assert simulated.status_code in {200, 503}
            assert restarts(service, "exited") == 0 if processes > 1 else True
            changed = client.post(f"/v2/repository/models/{MODEL}/unload")
            if processes > 1:
                assert (changed.status_code, changed.json()) == (
                    503,
                    {
                        "error": "The model is not changed, it cannot be shared with other "
                        "processes: No space left on device."
                    },
                )
            else:
                assert changed.status_code == 200
            assert change(client, "load") == (503 if processes > 1 else 200)
            assert service.workers() == workers
            subprocess.run([*inside, "rm /dev/shm/filler /tmp/filler"], check=True)
            assert change(client, "unload") == 200
            assert client.post("/simulate", json=SIMULATION).status_code == 200


def test_a_replaced_worker_needs_no_room_on_a_full_disk():
    with Service(2, prefix=own_disks("16m", "64k")) as service:
        inside = ["nsenter", "--mount", f"--target={service.popen.pid}", "sh", "-c"]
        subprocess.run([*inside, "cat /dev/zero > /dev/shm/x"], stderr=subprocess.DEVNULL)
        for worker in service.workers():
            worker.kill()
        with Client(service.address) as client:
            wait_until_ready(client)
        wait_for(lambda: restarts(service, "exited") == 2)
        assert predict(service).status_code == 200


def test_one_process_serves_without_shared_memory():
    with (
        Service(1, prefix=own_disks("4k", "4k")) as service,
        httpx2.Client(base_url=service.address, timeout=60) as client,
    ):
        assert predict(service).status_code == 200
        lost = client.post("/simulate", json=SIMULATION)
        assert (lost.status_code, lost.json()["type"]) == (503, "/problems/simulation-lost")
        assert predict(service).status_code == 200


def test_shared_files_go_where_there_is_room():
    with Service(2, prefix=own_disks("64k", "16m")) as service:
        assert predict(service).status_code == 200
        assert service.metric(r"rollcast_worker_restarts_total\{.*\}") == [0, 0]


def test_a_service_without_room_for_its_workers_says_so():
    with Service(2, wait=False, prefix=own_disks("64k", "64k")) as service:
        service.popen.communicate(timeout=60)
        assert service.popen.returncode == 1
        assert "no room for the shared files of the worker processes" in service.log()


def own_disks(shared_memory: str, temporary: str) -> list[str]:
    """Return a command that gives a program a /dev/shm and a /tmp of its own, of some sizes."""
    mounted = [
        f"mount -t tmpfs -o size={size} none {place}"
        for size, place in ((shared_memory, "/dev/shm"), (temporary, "/tmp"))
    ]
    command = ["unshare", "--mount", "sh", "-c", " && ".join([*mounted, 'exec "$@"']), "sh"]
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("file systems of its own need root")
    return command
