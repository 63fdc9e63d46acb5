"""The Python client of the service.

>>> from rollcast.client import Client
>>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     scene = client.simulate("hemisphere", seed=7)
...     forecast = client.predict(scene.frames[:4], horizon=40)
...     forecast.positions.shape
(1, 40, 2)

``AsyncClient`` has the same methods, to be awaited. ``predict_stream`` gives every step as soon as
it is computed, and the whole forecast afterwards; leaving its context ends it:

>>> with Client() as client, client.predict_stream(frames, horizon=400) as stream:  # doctest: +SKIP
...     for step in stream:
...         step.time_s, step.positions

A loop opens a session: the service keeps the last four frames, and the newest one wins.

>>> with Client() as client, client.session(horizon=20) as session:  # doctest: +SKIP
...     for frame in camera:
...         session.send(frame)
...         answer = session.newest()

Exceptions: ``rollcast.errors.ClientError`` and its heirs. A service for tests that need none:
``rollcast.client.testing``.
"""

from rollcast.client.aio import AsyncClient, AsyncForecastStream
from rollcast.client.aio_session import AsyncSession
from rollcast.client.images import Crop, Frame, Frames
from rollcast.client.prompts import BallPoint, BallPoints
from rollcast.client.results import Detections, Forecast, ForecastStep, Simulation, Surface
from rollcast.client.sessions import TickAnswer
from rollcast.client.sync import Client, ForecastStream
from rollcast.client.sync_session import Session
from rollcast.schemas import BallPrompt

__all__ = [
    "AsyncClient",
    "AsyncForecastStream",
    "AsyncSession",
    "BallPoint",
    "BallPoints",
    "BallPrompt",
    "Client",
    "Crop",
    "Detections",
    "Forecast",
    "ForecastStep",
    "ForecastStream",
    "Frame",
    "Frames",
    "Session",
    "Simulation",
    "Surface",
    "TickAnswer",
]
