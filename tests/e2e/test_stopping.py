"""What a real server does when it is told to stop."""

import signal
from collections.abc import Iterator
from functools import partial

import pytest

from rollcast.client import Client
from rollcast.errors import ServerError, UnreachableError
from tests.e2e.conftest import (
    LONGEST_HORIZON,
    long_forecasts,
    start_service,
    stop_service,
    wait_until_ready,
)

REQUESTS = 12


def health(client: Client) -> Iterator[str]:
    """What is said of its health until it is gone."""
    try:
        while True:
            yield client.health().status
    except UnreachableError:
        return


@pytest.mark.parametrize("order", [signal.SIGTERM, signal.SIGINT])
def test_it_stops_when_it_is_told_to(order):
    process, address = start_service()
    with Client(address) as client:
        wait_until_ready(client)
        client.simulate("hemisphere", seed=1, steps=4, include_frames=False)
        process.send_signal(order)
        process.communicate(timeout=30)
        with pytest.raises(UnreachableError):
            client.health()
    assert process.returncode in {0, -order}


def test_what_was_accepted_is_answered_before_it_stops():
    process, address = start_service(ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S="300")
    with Client(address) as client:
        wait_until_ready(client)
        with long_forecasts(address, REQUESTS) as answers:
            process.send_signal(signal.SIGTERM)
            said = set(health(client))
            assert [answer.result() for answer in answers] == [LONGEST_HORIZON] * REQUESTS
    assert said <= {"ready", "draining"}
    assert "draining" in said
    assert stop_service(process) in {0, -signal.SIGTERM}


def test_nothing_new_is_begun_while_it_drains():
    process, address = start_service(ROLLCAST_SHUTDOWN_DELAY_S="2")
    with Client(address, retries=0) as client:
        wait_until_ready(client)
        frames = client.simulate("hemisphere", seed=1, steps=4).frames
        process.send_signal(signal.SIGTERM)
        next(status for status in health(client) if status == "draining")
        for ask in (
            partial(client.predict, frames),
            partial(client.simulate, "hemisphere", seed=1),
        ):
            with pytest.raises(ServerError) as refused:
                ask()
            assert refused.value.problem.type == "/problems/not-ready"
    assert stop_service(process) in {0, -signal.SIGTERM}
