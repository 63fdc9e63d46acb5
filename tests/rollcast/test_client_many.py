"""Many calls side by side, with both clients."""

import asyncio
import threading
import time
from contextlib import contextmanager

import httpx2
import numpy as np
import pytest

from rollcast.client import AsyncClient
from rollcast.client.testing import FakeService
from rollcast.errors import BadRequestError

SIDES = [32 + 2 * index for index in range(12)]
SEQUENCES = [np.zeros((4, side, side, 3), np.uint8) for side in SIDES]


class Counting(httpx2.BaseTransport, httpx2.AsyncBaseTransport):
    """Counts who waits, and lets nobody go before so many have come at once."""

    def __init__(self, at_once):
        self.service = FakeService()
        self.at_once = at_once
        self.waiting = self.most = self.asked = 0
        self._lock = threading.Lock()
        self._deadline = time.monotonic() + 30

    def handle_request(self, request):
        with self._counted():
            while not self._come():
                time.sleep(0.001)
            return self.service.handle_request(request)

    async def handle_async_request(self, request):
        with self._counted():
            while not self._come():
                await asyncio.sleep(0.001)
            return await self.service.handle_async_request(request)

    @contextmanager
    def _counted(self):
        with self._lock:
            self.asked += 1
            self.waiting += 1
            self.most = max(self.most, self.waiting)
        try:
            yield
        finally:
            with self._lock:
                self.waiting -= 1

    def _come(self):
        assert time.monotonic() < self._deadline
        return self.most >= self.at_once


@pytest.mark.parametrize("concurrency", [1, 3])
def test_forecasts_come_in_order_and_few_are_asked_for_at_once(client, concurrency):
    service = Counting(concurrency)
    forecasts = client(service).predict_many(iter(SEQUENCES), concurrency=concurrency, horizon=2)
    assert [forecast.frame_size[0] for forecast in forecasts] == SIDES
    assert all(forecast.positions.shape == (1, 2, 2) for forecast in forecasts)
    assert service.most == concurrency


def test_every_sequence_may_have_its_final_frame(client):
    service = FakeService()
    forecasts = client(service).predict_many(
        SEQUENCES[:2], final_frames=[frames[0] for frames in SEQUENCES[:2]]
    )
    assert all(forecast.final_positions is not None for forecast in forecasts)
    assert all(sent.final_frame in sent.frames for sent in service.requests)


def test_the_first_that_fails_ends_them_all(client):
    wide = np.zeros((4, 48, 64, 3), np.uint8)
    service = Counting(2)
    with pytest.raises(BadRequestError, match="square"):
        client(service).predict_many([SEQUENCES[0], wide, *SEQUENCES * 20], concurrency=2)
    assert service.asked < 200
    assert service.waiting == 0


def test_whoever_stops_awaiting_leaves_nothing_running():
    service = Counting(3)  # two wait for a third that never comes

    async def scenario():
        async with AsyncClient(transport=service) as client:
            many = asyncio.ensure_future(client.predict_many(SEQUENCES, concurrency=2))
            while service.waiting < 2:
                await asyncio.sleep(0.001)
            many.cancel()
            with pytest.raises(asyncio.CancelledError):
                await many
            return asyncio.all_tasks() - {asyncio.current_task()}

    assert asyncio.run(scenario()) == set()
    assert (service.asked, service.waiting) == (2, 0)


def test_nothing_is_asked_of_nobody(client):
    assert client(FakeService()).predict_many([]) == []


@pytest.mark.parametrize("named", [{"concurrency": 0}, {"final_frames": []}], ids=str)
def test_what_does_not_fit_is_told_before_anything_is_sent(client, named):
    service = FakeService()
    with pytest.raises(ValueError, match=r"concurrency is 0|shorter"):
        client(service).predict_many(SEQUENCES, **named)
    assert service.requests == []
