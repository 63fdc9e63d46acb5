"""Streams of the real server, and clients that go away."""

import base64
import io
import time

import httpx2
import pytest
from PIL import Image

from rollcast.client import Client

HORIZON = 1000


@pytest.fixture(scope="module")
def body(address) -> dict[str, object]:
    with Client(address) as client:
        frames = client.simulate("hemisphere", seed=7, steps=4).frames
    assert frames is not None
    images: list[str] = []
    for frame in frames:
        buffer = io.BytesIO()
        Image.fromarray(frame).save(buffer, "PNG")
        images.append(base64.b64encode(buffer.getvalue()).decode())
    return {"frames": images, "model": "posnet", "horizon": HORIZON}


def test_the_first_step_arrives_before_the_last_is_computed(address, body):
    arrivals: list[float] = []
    start = time.perf_counter()
    with httpx2.stream("POST", f"{address}/predict/stream", json=body) as response:
        assert response.status_code == 200
        for line in response.iter_lines():
            if line.startswith("event: "):
                arrivals.append(time.perf_counter() - start)
    assert len(arrivals) == HORIZON + 1
    assert arrivals[0] < 0.5 * arrivals[-1]


def test_clients_that_go_away_leave_the_service_free(address, body):
    """Far more of them than there are workers and places in the queue."""
    for _ in range(100):
        with httpx2.stream("POST", f"{address}/predict/stream", json=body) as response:
            assert response.status_code == 200
            next(response.iter_lines())
    answer = httpx2.post(f"{address}/predict", json=body | {"horizon": 5}, timeout=30)
    assert answer.status_code == 200
    assert len(answer.json()["times_s"]) == 5
