import multiprocessing
import os
import resource
import signal
import time
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from service.errors import DeadlineExceededError
from service.simulation.pool import RecycledProcess


def submit(process, call, *args, abandoned=None):
    return process.submit(abandoned or Future(), call, *args)


@pytest.fixture
def process():
    process = RecycledProcess(recycle_after=3, timeout_s=30)
    yield process
    process.close()


def test_the_process_is_replaced_after_its_calls(process):
    pids = [submit(process, os.getpid).result() for _ in range(7)]
    assert pids[0] == pids[1] == pids[2]
    assert pids[3] == pids[4] == pids[5]
    assert len(set(pids)) == 3
    assert os.getpid() not in pids


def test_a_process_that_dies_is_replaced(process):
    with pytest.raises(BrokenProcessPool):
        submit(process, os._exit, 1).result()
    assert submit(process, max, 1, 2).result() == 2


def test_a_process_that_dies_takes_no_call_that_waits(process):
    lost, waiting = submit(process, os._exit, 1), submit(process, max, 1, 2)
    with pytest.raises(BrokenProcessPool):
        lost.result()
    assert waiting.result() == 2


def stop_itself() -> None:
    """Stop this process, which then reacts to SIGKILL only."""
    os.kill(os.getpid(), signal.SIGSTOP)


def test_a_process_that_is_stuck_is_killed_and_the_next_call_answered():
    process = RecycledProcess(recycle_after=10, timeout_s=5)  # the next one's start is in it, too
    pid = submit(process, os.getpid).result()
    stuck, waiting = submit(process, stop_itself), submit(process, max, 1, 2)
    with pytest.raises(DeadlineExceededError, match="was not complete after 5 s"):
        stuck.result()
    assert waiting.result() == 2
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    process.close()


def test_a_call_that_is_abandoned_ends_with_its_process(process):
    pid = submit(process, os.getpid).result()
    abandoned: Future[None] = Future()
    left, waiting = (
        submit(process, time.sleep, 600, abandoned=abandoned),
        submit(process, max, 1, 2),
    )
    time.sleep(0.2)
    abandoned.set_result(None)
    assert isinstance(left.exception(timeout=30), CancelledError)
    assert waiting.result() == 2
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_call_that_is_abandoned_and_nearly_done_keeps_its_process(process):
    pid = submit(process, os.getpid).result()
    abandoned: Future[None] = Future()
    abandoned.set_result(None)
    submit(process, max, 1, 2, abandoned=abandoned).result()
    assert submit(process, os.getpid).result() == pid


def test_a_stuck_call_does_not_keep_the_executor():
    process = RecycledProcess(recycle_after=10, timeout_s=600)
    pid = submit(process, os.getpid).result()
    stuck = submit(process, stop_itself)
    while "T" not in Path(f"/proc/{pid}/stat").read_text().split()[2]:
        time.sleep(0.01)
    process.close()
    assert isinstance(stuck.exception(), BrokenProcessPool)


def test_a_stuck_simulation_is_504_and_the_next_is_answered(start):
    client = start(simulation_timeout_s=15)  # starts of the process included
    asked = {"scenario": "hemisphere", "seed": 1, "steps": 4, "include_frames": False}
    assert client.post("/simulate", json=asked).status_code == 200
    for child in multiprocessing.active_children():
        assert child.pid is not None
        os.kill(child.pid, signal.SIGSTOP)
    answer = client.post("/simulate", json=asked)
    assert (answer.status_code, answer.json()["type"]) == (504, "/problems/deadline-exceeded")
    assert client.post("/simulate", json=asked).status_code == 200


def test_a_process_that_cannot_be_started_is_told_and_started_later(process):
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, before[1]))
    try:
        for _ in range(2):
            with pytest.raises(BrokenProcessPool):
                submit(process, max, 1, 2).result()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert submit(process, max, 1, 2).result() == 2


def test_a_lost_simulation_is_503_and_the_next_is_answered(start):
    client = start()
    asked = {"scenario": "hemisphere", "seed": 1, "steps": 4, "include_frames": False}

    assert client.post("/simulate", json=asked).status_code == 200
    children = multiprocessing.active_children()
    assert children
    for child in children:
        child.kill()
        child.join()
    statuses = [client.post("/simulate", json=asked).status_code for _ in range(2)]
    assert statuses in ([503, 200], [200, 200])
