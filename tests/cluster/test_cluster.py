"""The service on three nodes of Ray: it answers as it does alone, whatever happens to them."""

import subprocess
import sys
from collections import Counter

import httpx2
import pytest

from tests.cluster.faults import NEW_VERSION, suffer
from tests.cluster.load import LARGEST_DIFFERENCE_PX, Load, questions
from tests.e2e.conftest import ASKED, ROOT, assert_same_forecasts

CONTRACT = (
    "tests/contract/test_api.py",
    "tests/contract/test_inference.py",
    "tests/e2e/test_streaming.py",
)
CALLS = 1200
CLIENTS = 8


def test_every_answer_names_its_replica(running):
    answers = [httpx2.get(f"{running.address}/health/ready") for _ in range(30)]
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.headers["x-rollcast-replica"] for answer in answers}) > 1


@pytest.mark.parametrize("asked", ASKED, ids=str)
def test_it_answers_as_the_checkout_does(running, checkout, asked):
    assert_same_forecasts(running.address, checkout, asked)


def test_it_keeps_the_contract(running):
    """The tests of the app alone, asked of the cluster."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *CONTRACT, "--address", running.address],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_a_deadline_is_the_services_own(running):
    answer = httpx2.post(
        f"{running.address}/predict", json={}, headers={"x-request-timeout-ms": "0"}
    )
    assert answer.status_code == 422


def test_no_accepted_request_is_lost(running, checkout, tmp_path):
    load = Load(running.address, questions(checkout, range(6)), CLIENTS)
    faults = suffer(running, load, tmp_path, CALLS)
    for phase in faults.phases:
        print(
            f"{phase.name}: {len(phase.answers)} answers, p50 {phase.quantile_ms(0.5):.0f} ms, "
            f"p99 {phase.quantile_ms(0.99):.0f} ms"
        )
    print(f"{faults.accepted} accepted, {faults.retried} asked more than once")
    assert faults.retried, "no replica was killed at work"
    assert not faults.failures
    assert faults.accepted >= 5 * CALLS
    assert len(faults.answered_by) == faults.accepted
    assert set(Counter(map(len, faults.answered_by.values()))) == {1}, "answered twice"
    for phase in faults.phases:
        assert phase.largest_difference_px <= LARGEST_DIFFERENCE_PX
    assert {one.version for one in faults.phases[0].answers} == {1}
    assert {one.version for one in faults.phases[-1].answers} == {NEW_VERSION}
