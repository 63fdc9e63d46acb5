"""The awaited client and the real app in one process, as users' own tests may have them."""

import asyncio
from contextlib import asynccontextmanager

import httpx2
import numpy as np
import pytest

from rollcast.client import AsyncClient
from rollcast.errors import BadRequestError
from service.app import create_app
from service.settings import Settings
from tests.service import samples
from tests.service.samples import dot

FRAMES = [dot(40 + 2 * index, 60 + index) for index in range(4)]


@asynccontextmanager
async def connected(folder):
    app = create_app(Settings(models_dir=folder), samples.registry)
    async with (
        app.router.lifespan_context(app),
        AsyncClient(transport=httpx2.ASGITransport(app=app)) as client,
    ):
        while (await client.health()).status == "loading":
            await asyncio.sleep(0.01)
        yield client


def test_a_forecast_and_its_stream(tmp_path):
    async def scenario():
        async with connected(tmp_path) as client:
            whole = await client.predict(FRAMES, horizon=5)
            stream = client.predict_stream(FRAMES, horizon=5)
            steps = [step async for step in stream]
            return whole, steps, stream.forecast

    whole, steps, streamed = asyncio.run(scenario())
    np.testing.assert_allclose(whole.positions[0, :, 0], 46 + 2 * np.arange(5), atol=0.1)
    assert [step.step for step in steps] == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(streamed.positions, whole.positions)
    np.testing.assert_array_equal(
        np.stack([step.angular_velocities for step in steps], axis=1), whole.angular_velocities
    )


def test_refusals_and_models(tmp_path):
    async def scenario():
        async with connected(tmp_path) as client:
            with pytest.raises(BadRequestError, match="404"):
                await client.predict(FRAMES, model="nobody")
            with pytest.raises(BadRequestError) as caught:
                await anext(client.predict_stream(FRAMES, horizon=0))
            assert caught.value.problem.field == "horizon"
            assert (await client.model("dot")).version == 1
            return await client.models()

    models = asyncio.run(scenario())
    assert [model.reason for model in models if model.name == "broken"]
