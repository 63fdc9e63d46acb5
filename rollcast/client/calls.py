"""Every call of the API as a value: the request to send, and how to read its answer.

Nothing here sends anything, so a client is a transport and one line a method.
"""

import uuid
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypedDict, TypeVar, cast
from urllib.parse import quote

import httpx2
import numpy as np
from pydantic import ValidationError

from rollcast.client.images import Crop, Frame, Frames, each, encoded
from rollcast.client.results import Forecast, Simulation
from rollcast.errors import (
    BusyError,
    ClientError,
    DeniedError,
    ProblemError,
    RefusedError,
    ServiceFailedError,
    UnexpectedAnswerError,
    UnreachableError,
)
from rollcast.scene import Domain, Scenario, Scene
from rollcast.schemas import (
    REQUEST_ID_HEADER,
    Health,
    ModelDetail,
    ModelEntry,
    ModelList,
    PredictResponse,
    Problem,
    SimulateResponse,
)

T = TypeVar("T")

Part = tuple[str, tuple[str, bytes]]


class ForecastOptions(TypedDict, total=False):
    """What may be said of a forecast besides its frames; what is left out is the service's choice.

    These are the keyword arguments of ``Client.predict``, which describes them.
    """

    horizon: int | None
    """Steps."""
    model: str
    """A NAME, NAME@VERSION or "auto"."""
    final_step: int | None
    """Step that the final frame shows."""
    objects: int | None
    """Number of balls."""
    scenario: Domain | None
    """Narrows the choice of "auto"."""
    frame_rate: float | None
    """Frames a second."""
    crop: Crop | None
    """"square" cuts the largest square out of the middle of every frame."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request and the reader of its answer."""

    method: str
    path: str
    read: Callable[[bytes], T]
    json: Mapping[str, Any] | None = None
    fields: Mapping[str, str] | None = None
    files: Sequence[Part] | None = None
    answers: tuple[int, ...] = (200,)
    """Statuses whose body ``read`` understands."""

    def request(self, client: httpx2.Client | httpx2.AsyncClient) -> httpx2.Request:
        """Return the request for a client's base address."""
        return client.build_request(
            self.method,
            self.path,
            json=self.json,
            data=self.fields,
            files=self.files,
            headers={REQUEST_ID_HEADER: uuid.uuid4().hex},  # the same when it is sent again
        )

    def result(self, response: httpx2.Response) -> T:
        """Read the answer.

        Raises
        ------
        ProblemError
            When it is a problem document.
        UnexpectedAnswerError
            When it is not an answer of this API.
        """
        if response.status_code not in self.answers:
            raise failure(response)
        try:
            return self.read(response.content)
        except ValidationError as error:
            raise unexpected(response) from error


def failure(response: httpx2.Response) -> ClientError:
    """Return the exception for an answer that is none; its body has been read."""
    try:
        told = problem_error(Problem.model_validate_json(response.content))
    except ValidationError as error:
        told = unexpected(response)
        told.__cause__ = error
    told.retry_after_s = _retry_after_s(response)
    return told


def unexpected(response: httpx2.Response) -> UnexpectedAnswerError:
    """Return the exception for a body that is not one of this API's."""
    return UnexpectedAnswerError(
        f"{response.url} answered {response.status_code} with a body that is not this API's",
        response.status_code,
    )


@contextmanager
def reaching(request: httpx2.Request) -> Generator[None]:
    """Translate what goes wrong on the way to the service and back.

    Raises
    ------
    UnreachableError
        When no answer came, or not all of one.
    """
    try:
        yield
    except httpx2.TransportError as error:
        raise UnreachableError(f"{request.url} does not answer: {error!r}") from error


def problem_error(problem: Problem) -> ProblemError:
    """Return the exception for a problem document."""
    if problem.status in {401, 403}:
        return DeniedError(problem)
    if problem.status == 429:
        return BusyError(problem)
    return ServiceFailedError(problem) if problem.status >= 500 else RefusedError(problem)


def _retry_after_s(response: httpx2.Response) -> float:
    """Read the header Retry-After; a date, which this service never sends, counts as nothing."""
    text = response.headers.get("retry-after", "")
    return float(text) if text.isascii() and text.isdecimal() else 0.0


def predict(frames: Frames, final_frame: Frame | None, options: ForecastOptions) -> Call[Forecast]:
    """Send frames as file parts; what is not said is left to the service."""
    return _forecast_call(
        "/predict",
        lambda body: Forecast.from_response(PredictResponse.model_validate_json(body)),
        frames,
        final_frame,
        options,
    )


def predict_stream(
    frames: Frames, final_frame: Frame | None, options: ForecastOptions
) -> Call[None]:
    """Ask as ``predict`` does; the answer is a stream of events (``rollcast.client.stream``)."""
    return _forecast_call("/predict/stream", lambda _: None, frames, final_frame, options)


def _forecast_call(
    path: str,
    read: Callable[[bytes], T],
    frames: Frames,
    final_frame: Frame | None,
    options: ForecastOptions,
) -> Call[T]:
    crop = options.get("crop")
    files: list[Part] = [
        ("frames", (f"frame{index}", encoded(frame, crop)))
        for index, frame in enumerate(each(frames))
    ]
    if final_frame is not None:
        files.append(("final_frame", ("final_frame", encoded(final_frame, crop))))
    fields = {
        name: str(value) for name, value in options.items() if name != "crop" and value is not None
    }
    return Call("POST", path, read, fields=fields, files=files)


def simulate(
    scenario: Scenario | None,
    seed: int | None,
    scene: Scene | Mapping[str, Any] | None,
    fields: Mapping[str, object],
) -> Call[Simulation]:
    """Ask for a scene; what is None is left to the service."""
    parameters = scene.model_dump(mode="json") if isinstance(scene, Scene) else scene
    body = {"scenario": scenario, "seed": seed, "scene": parameters, **fields}
    return Call(
        "POST",
        "/simulate",
        lambda body: Simulation.from_response(SimulateResponse.model_validate_json(body)),
        json={name: _plain(value) for name, value in body.items() if value is not None},
    )


def _plain(value: object) -> object:
    """Return a NumPy scalar as a number that JSON knows."""
    return cast("object", value.item()) if isinstance(value, np.generic) else value


def models() -> Call[list[ModelEntry]]:
    """List every version of every model."""
    return Call("GET", "/models", lambda body: ModelList.model_validate_json(body).models)


def model(name: str, version: int | None) -> Call[ModelDetail]:
    """Return one version of a model, by default the default one, with its card."""
    path = f"/models/{quote(name, safe='')}"
    if version is not None:
        path += f"/versions/{version}"
    return Call("GET", path, ModelDetail.model_validate_json)


def health() -> Call[Health]:
    """Ask whether forecasts are answered."""
    return Call("GET", "/health/ready", Health.model_validate_json, answers=(200, 503))
