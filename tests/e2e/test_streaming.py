"""Streams of the real server, and clients that go away."""

import asyncio
import base64
import io
import time

import httpx2
import numpy as np
import pytest
from PIL import Image

from rollcast.client import AsyncClient, Client

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


@pytest.fixture(scope="module")
def frames(address):
    with Client(address) as client:
        return client.simulate("hemisphere", seed=7, steps=4).frames


def test_a_streamed_forecast_is_that_of_predict(client, frames):
    whole = client.predict(frames, horizon=60)
    with client.predict_stream(frames, horizon=60) as stream:
        arrived = np.stack([step.positions for step in stream], axis=1)
    np.testing.assert_allclose(arrived, whole.positions, atol=1e-2)
    np.testing.assert_array_equal(stream.forecast.positions, arrived)
    assert stream.forecast.warnings == whole.warnings


def test_streams_that_are_left_early_free_the_service(client, frames):
    """Far more of them than there are workers and places in the queue."""
    for _ in range(100):
        with client.predict_stream(frames, model="posnet", horizon=HORIZON) as stream:
            assert next(stream).step == 0
    assert client.predict(frames, horizon=5).positions.shape == (1, 5, 2)


def test_the_awaited_client_answers_as_the_other(address, client, frames):
    expected = client.predict(frames, horizon=20)

    async def ask():
        async with AsyncClient(address) as awaited:
            forecast = await awaited.predict(frames, horizon=20)
            many = await awaited.predict_many([frames] * 12, horizon=20, concurrency=6)
            async with awaited.predict_stream(frames, model="posnet", horizon=HORIZON) as stream:
                first = await anext(stream)
            scene = await awaited.simulate("hemisphere", seed=7, steps=4)
            return [forecast, *many], first, scene, await awaited.models()

    forecasts, first, scene, models = asyncio.run(ask())
    for forecast in forecasts:
        np.testing.assert_allclose(forecast.positions, expected.positions, atol=1e-2)
    assert first.step == 0
    np.testing.assert_array_equal(scene.frames, frames)
    assert models == client.models()


def test_many_forecasts_by_threads(client, frames):
    expected = client.predict(frames, horizon=20)
    for forecast in client.predict_many([frames] * 12, horizon=20, concurrency=6):
        np.testing.assert_allclose(forecast.positions, expected.positions, atol=1e-2)
