"""A fake service for unit tests: it answers at once, in the process, without models.

>>> from rollcast.client import Client
>>> from rollcast.client.testing import FakeService
>>> with Client(transport=FakeService()) as client:
...     scene = client.simulate("hemisphere", seed=7)
...     forecast = client.predict(scene.frames[:4], horizon=20)
>>> forecast.positions.shape
(1, 20, 2)

Its answers are valid, its forecasts chosen by the test. Clients take any other transport of
``httpx2`` as well. The real app needs neither a port nor a process, if its lifespan is run:

    app = create_app(Settings())
    async with app.router.lifespan_context(app):
        client = AsyncClient(transport=httpx2.ASGITransport(app=app))
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import httpx2
import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ValidationError

from rollcast.client import fakes
from rollcast.client.answers import problem_error
from rollcast.client.fake_session import FakeSession
from rollcast.client.fakes import RefusalError
from rollcast.schemas import (
    DetectRequest,
    Health,
    ModelList,
    PredictRequest,
    Problem,
    SimulateRequest,
)

__all__ = ["FakeService", "RecordedRequest"]


@dataclass(frozen=True)
class RecordedRequest:
    """A request that a fake service has got."""

    method: str
    path: str
    fields: Mapping[str, Any]
    """Content of the JSON body, or the form's fields as text."""
    frames: Sequence[bytes] = ()
    """The image files of the observed frames; of a session, all frames that have been sent."""
    final_frame: bytes | None = None
    """The image file of a later one."""


class FakeService(httpx2.MockTransport):
    """A transport for ``Client`` and ``AsyncClient`` that answers like a service.

    By default, balls move along lines, and forecasts continue the lines of the simulations or
    start at the point prompts (``balls``). Requests with an invalid shape (a horizon of 0, three
    frames) are rejected as by the real service. Frames of a session are answered at once, so that
    none is superseded.

    Parameters
    ----------
    positions
        The forecast, [objects, steps, 2] in pixels of the frames, or [steps, 2] of one ball. A
        longer horizon is refused.
    variance_px2
        Of every coordinate at every step, square pixels.
    problem
        Refuses every call but ``health`` with this document, see ``problem``.

    Attributes
    ----------
    problem
        The document, None to answer; may be changed at any time.
    requests
        All requests that came, in order.
    """

    def __init__(
        self,
        positions: ArrayLike | None = None,
        *,
        variance_px2: float = 1.0,
        problem: Problem | None = None,
    ) -> None:
        super().__init__(self._answer)
        self.problem = problem
        self.requests: list[RecordedRequest] = []
        self._variance_px2 = variance_px2
        self._positions: np.ndarray | None = None
        if positions is not None:
            given = np.asarray(positions, float)
            self._positions = given[None] if given.ndim == 2 else given

    def open_session(self, message: str) -> FakeSession:
        """Open the session of a client, whose first message it gets.

        Raises
        ------
        rollcast.errors.ProblemError
            With ``problem``.
        """
        frames: list[bytes] = []
        self.requests.append(RecordedRequest("GET", "/stream", json.loads(message), frames))
        if self.problem is not None:
            raise problem_error(self.problem)
        return FakeSession(self._positions, self._variance_px2, lambda: self.problem, frames)

    def _answer(self, request: httpx2.Request) -> httpx2.Response:
        try:
            recorded = _read(request)
            self.requests.append(recorded)
            if recorded.path == "/health/ready":
                return _json(Health(status="ready"))
            if self.problem is not None:
                raise RefusalError(self.problem)
            return self._served(recorded)
        except ValidationError as error:
            return _refused(fakes.invalid(error))
        except RefusalError as refusal:
            return _refused(refusal.problem)

    def _served(self, recorded: RecordedRequest) -> httpx2.Response:
        match recorded.method, recorded.path.strip("/").split("/"):
            case "POST", ["predict", *stream] if stream in ([], ["stream"]):
                body = fakes.typed(recorded.fields, recorded.frames, recorded.final_frame)
                predict_request = PredictRequest.model_validate(body)
                forecast = fakes.forecast(predict_request, self._positions, self._variance_px2)
                if not stream:
                    return _json(forecast)
                return httpx2.Response(
                    200,
                    headers={"content-type": "text/event-stream"},
                    content=fakes.events(forecast),
                )
            case "POST", ["detect"]:
                body = fakes.typed(recorded.fields, recorded.frames, None)
                del body["final_frame"]
                return _json(fakes.detection(DetectRequest.model_validate(body)))
            case "POST", ["simulate"]:
                return _json(fakes.simulation(SimulateRequest.model_validate(recorded.fields)))
            case "GET", ["models"]:
                return _json(ModelList(models=[fakes.model()]))
            case "GET", ["models", fakes.NAME] | ["models", fakes.NAME, "versions", "1"]:
                return _json(fakes.model())
            case _:
                raise RefusalError(fakes.nothing_here(f"{recorded.method} {recorded.path}"))


def _read(request: httpx2.Request) -> RecordedRequest:
    kind, _, parameters = request.headers.get("content-type", "").partition(";")
    method, path, body = request.method, request.url.path, request.content
    if kind == "multipart/form-data":
        return RecordedRequest(
            method, path, *fakes.parts(body, parameters.partition("boundary=")[2])
        )
    return RecordedRequest(method, path, json.loads(body) if body else {})


def _json(body: BaseModel) -> httpx2.Response:
    return httpx2.Response(
        200, headers={"content-type": "application/json"}, content=body.model_dump_json()
    )


def _refused(problem: Problem) -> httpx2.Response:
    return httpx2.Response(
        problem.status,
        headers={"content-type": "application/problem+json"},
        content=problem.model_dump_json(),
    )
