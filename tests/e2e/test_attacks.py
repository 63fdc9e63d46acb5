"""Attacks on a real server process, while good requests go on.

In every one no good request is lost, the process stays alive and answers, its memory comes back,
and an order to stop is obeyed in time although the attack goes on. What the good requests wait
meanwhile needs a machine that does nothing else: ``make faults``.
"""

import time
from collections.abc import Iterator

import pytest

from tests.e2e.attacks import (
    ATTACKS,
    STOP_TIMEOUT_S,
    Service,
    good_requests,
    one_model,
    repeated,
    started,
)

SETTLED_S = 20
"""Seconds in which memory may come back."""
ALLOWED_GROWTH = 1.05
SLACK_BYTES = 24 * 2**20
"""Memory that the allocator may keep for later, beside the share that is allowed."""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return one_model(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def service(models) -> Iterator[Service]:
    with started(models) as service:
        yield service


@pytest.fixture(scope="module")
def resting(service) -> int:
    """Memory of the service once it has answered what it will be asked."""
    with good_requests(service):
        for attack in ATTACKS.values():
            attack(service)
    return service.memory


@pytest.mark.parametrize("attack", ATTACKS)
def test_no_good_request_is_lost_and_memory_comes_back(service, resting, attack):
    with good_requests(service) as good:
        statuses = ATTACKS[attack](service)
    assert not good.lost
    assert all(status == 0 or 400 <= status < 500 for status in statuses), statuses
    deadline = time.monotonic() + SETTLED_S
    allowed = ALLOWED_GROWTH * resting + SLACK_BYTES
    while service.memory > allowed and time.monotonic() < deadline:
        time.sleep(0.1)
    assert service.memory <= allowed


def test_it_stops_in_time_while_all_of_them_go_on(models):
    with started(models) as service, repeated(service, *ATTACKS):
        time.sleep(3)
        service.process.terminate()
        # A machine that does other things needs its time to unwind, too.
        service.process.wait(STOP_TIMEOUT_S + 15)
