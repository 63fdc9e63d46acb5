"""What users write, as pyright sees it: what is right passes, and what is wrong is an error.

Never run; pyright checks it with the package (`make lint`).
"""
# pyright: reportUnnecessaryTypeIgnoreComment=true

from pathlib import Path
from typing import assert_type

import httpx2
import numpy as np
import pandas as pd
from PIL import Image

from rollcast.client import (
    AsyncClient,
    AsyncForecastStream,
    BallPrompt,
    Client,
    Forecast,
    ForecastStep,
    ForecastStream,
    Simulation,
    Surface,
)
from rollcast.client.testing import FakeService
from rollcast.errors import ClientError, OverloadedError, ProblemError
from rollcast.schemas import Health, ModelDetail, ModelEntry, Problem


def right(frames: list[np.ndarray]) -> None:
    with Client("http://127.0.0.1:8000", timeout_s=5, retries=0) as client:
        forecast = client.predict(frames, horizon=20, model="auto", num_objects=2, crop="square")
        client.predict(frames, balls=[(40, 50), (90, 30, 8.0), BallPrompt(x=1, y=2)])
        client.predict(frames, balls=np.zeros((2, 3)))
        assert_type(forecast, Forecast)
        assert_type(forecast.to_dataframe(), pd.DataFrame)
        assert_type(forecast.plot(frames[3:]), Image.Image)
        forecast.plot([frames[3]], times_s=[0.0], panels=2).save("overlay.png")
        client.predict(np.zeros((4, 64, 64, 3), np.uint8))
        client.predict([Path("a.png"), "b.png", frames[2], Image.new("RGB", (64, 64))])
        scene = client.simulate("ellipsoid", seed=7)
        assert_type(scene, Simulation[np.ndarray, None])
        ground = client.simulate("heightfield", seed=np.int64(7), include_surface=True)
        assert_type(ground.surface, Surface)
        any_scene: Simulation = client.simulate("ellipsoid", seed=7, include_frames=False)
        assert_type(any_scene.frames, np.ndarray | None)
        assert_type(any_scene.surface, Surface | None)
        client.predict("clip.mp4", start_s=2.0, horizon=np.int64(20))
        forecast.save("overlay.png", scene.frames[3:])
        assert_type(forecast.to_json(), str)
        client.predict(scene.frames[:4], scenario="ellipsoid", final_frame=scene.frames[42])
        assert_type(client.predict_many([frames, scene.frames[:4]], horizon=5), list[Forecast])
        assert_type(client.models(), list[ModelEntry])
        assert_type(client.model("posnet"), ModelDetail)
        assert_type(client.health(), Health)
        with client.predict_stream(frames, horizon=40) as stream:
            assert_type(stream, ForecastStream)
            for step in stream:
                assert_type(step, ForecastStep)
        assert_type(stream.forecast, Forecast)


async def right_when_awaited(frames: list[np.ndarray]) -> None:
    async with AsyncClient() as client:
        assert_type(await client.predict(frames), Forecast)
        assert_type(await client.predict_many([frames] * 3, concurrency=2), list[Forecast])
        scene = await client.simulate("ellipsoid", seed=7)
        assert_type(scene, Simulation[np.ndarray, None])
        assert_type(await client.health(), Health)
        async with client.predict_stream(frames, horizon=40, model="posnet") as stream:
            assert_type(stream, AsyncForecastStream)
            async for step in stream:
                assert_type(step, ForecastStep)


def right_in_tests(frames: list[np.ndarray], problem: Problem) -> None:
    service = FakeService([[1.0, 2.0], [3.0, 4.0]], problem=problem)
    AsyncClient(transport=service)
    try:
        Client(transport=service).predict(frames)
    except OverloadedError as error:
        assert_type(error.retry_after_s, float)
    except ProblemError as error:
        assert_type(error.problem.field, str | None)
    except ClientError:
        pass


def wrong(client: Client, frames: list[np.ndarray]) -> None:
    client.predict(frames, 20)  # pyright: ignore[reportCallIssue]
    client.predict(frames, horizon="20")  # pyright: ignore[reportArgumentType]
    client.predict(frames, crop="round")  # pyright: ignore[reportArgumentType]
    client.predict(frames, steps=20)  # pyright: ignore[reportCallIssue]
    client.predict_stream(frames, horizon="20")  # pyright: ignore[reportArgumentType]
    client.predict_stream(frames, steps=20)  # pyright: ignore[reportCallIssue]
    client.predict_many([frames], scenario="box")  # pyright: ignore[reportArgumentType]
    client.predict_many(frames, final_frame=frames[0])  # pyright: ignore[reportCallIssue]
    client.simulate("box", seed=1)  # pyright: ignore[reportCallIssue, reportArgumentType]
    client.predict(frames).positions = frames[0]  # pyright: ignore[reportAttributeAccessIssue]
    client.simulate("ellipsoid", include_frames=False).frames[:4]  # pyright: ignore[reportOptionalSubscript]
    Client(transport=httpx2.AsyncHTTPTransport())  # pyright: ignore[reportArgumentType]


async def wrong_when_awaited(client: AsyncClient, frames: list[np.ndarray]) -> None:
    client.predict(frames)  # pyright: ignore[reportUnusedCoroutine]
    (await client.health()).reload()  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]
    for _ in client.predict_stream(frames):  # pyright: ignore[reportGeneralTypeIssues, reportUnknownVariableType]
        pass
