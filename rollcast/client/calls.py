"""Every call of the API as a value: the request to send, and how to read its answer.

Nothing here sends anything, so a client is a transport and one line a method.
"""

import json
import operator
import os
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, SupportsIndex, TypeAlias, TypedDict, TypeVar, cast
from urllib.parse import quote

import httpx2
import numpy as np

from rollcast.client.answers import MAX_ANSWER_BYTES, MAX_SIMULATION_BYTES, failure, unexpected
from rollcast.client.images import Crop, Frame, Frames, each, encoded
from rollcast.client.prompts import BallPoints, prompts_of
from rollcast.client.results import Detections, Forecast, Simulation
from rollcast.client.shapes import require
from rollcast.errors import ClientError, InvalidArgumentError, ProblemError
from rollcast.frames import Channels
from rollcast.image_sequence import numbering_warnings
from rollcast.scene import Domain, Scenario, Scene
from rollcast.schemas import (
    MAX_HORIZON,
    MAX_RATE_HZ,
    MIN_RATE_HZ,
    REQUEST_ID_HEADER,
    DetectResponse,
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
Integer: TypeAlias = int | np.integer[Any]
"""A whole number of Python's or of NumPy's."""


class ForecastOptions(TypedDict, total=False):
    """Options of a forecast. The service chooses defaults for omitted options.

    These are the keyword arguments of ``Client.predict``, which describes them.
    """

    horizon: Integer | None
    """Steps."""
    model: str
    """Name: NAME, NAME@VERSION or "auto"."""
    num_objects: Integer | None
    """Number of balls."""
    balls: BallPoints | None
    """Points of the last observed frame, pixels, that say which balls are meant."""
    scenario: Domain | None
    """Domain that narrows the choice of "auto"."""
    frame_rate: float | None
    """Frames a second."""
    step_rate: float | None
    """Steps a second."""
    crop: Crop | None
    """Crop of every frame: "square" cuts the largest square out of the middle."""
    start_s: float | None
    """Time of the first frame in a clip, seconds."""
    channels: Channels
    """Order of the channels of arrays and tensors: "rgb" or "bgr"."""
    camera_hz: float | None
    """Frames a second that the camera of a clip took."""


class SimulationOptions(TypedDict, total=False):
    """Options of a simulation: keyword arguments of ``Client.simulate``, which describes them."""

    seed: Integer | None
    """Seed of the scene."""
    num_objects: Integer | None
    """Number of balls."""
    steps: Integer
    """Frames, at the frame rate of simulations."""
    start_step: Integer | None
    """First step, counted from the start of the simulation."""
    image_size: Integer
    """Side of the frames, pixels."""
    textured: bool | None
    """Texture on the ball."""
    scene: Scene | Mapping[str, Any] | None
    """Scene, or fields of one."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request and the reader of its answer."""

    method: str
    path: str
    read: Callable[[bytes | bytearray], T]
    """Reader of the body; its exceptions are reported as an invalid answer."""
    json: Mapping[str, Any] | None = None
    fields: Mapping[str, str] | None = None
    files: Sequence[Part] | None = None
    answers: tuple[int, ...] = (200,)
    """Statuses whose body ``read`` understands."""
    max_bytes: int = MAX_ANSWER_BYTES
    """Largest answer that is read."""
    horizon: int | None = None
    """Number of requested steps."""
    num_objects: int | None = None
    """Number of requested balls."""
    advise: Callable[[Problem], str] = lambda _: ""
    """Advice about a refusal in terms of the client; empty if there is none."""
    warnings: tuple[str, ...] = ()
    """Warnings of the client about a forecast."""

    def request(self, client: httpx2.Client | httpx2.AsyncClient, timeout: float) -> httpx2.Request:
        """Return the request for a client's base address.

        Raises
        ------
        InvalidArgumentError
            When an argument cannot be written into a request.
        """
        headers = {REQUEST_ID_HEADER: uuid.uuid4().hex}  # the same when it is sent again
        content = None
        try:
            if self.json is not None:
                headers["Content-Type"] = "application/json"
                content = json.dumps(self.json, default=_plain, allow_nan=False).encode()
            return client.build_request(
                self.method,
                self.path,
                content=content,
                data=self.fields,
                files=self.files,
                headers=headers,
                timeout=timeout,
            )
        except (TypeError, ValueError, RecursionError, httpx2.InvalidURL) as error:
            raise InvalidArgumentError(f"{self.path} cannot be requested: {error}") from error

    def result(self, response: httpx2.Response, content: bytes | bytearray) -> T:
        """Read the answer.

        Raises
        ------
        ProblemError
            When it is a problem document.
        UnexpectedAnswerError
            When it is not an answer of this API.
        """
        if response.status_code not in self.answers:
            raise self.failure(response, content)
        try:
            return self.read(content)
        except Exception as error:  # decoders of images raise nearly anything
            raise unexpected(response, error) from error

    def failure(self, response: httpx2.Response, content: bytes | bytearray) -> ClientError:
        """Return the exception for an answer that reports a failure."""
        error = failure(response, content)
        if isinstance(error, ProblemError):
            error.advice = self.advise(error.problem)
        return error

    def expect_at_most(self, steps: int) -> None:
        """Raise ValueError if a forecast has more steps than requested."""
        most = self.horizon or MAX_HORIZON
        require(steps <= most, f"the forecast has more than {most} steps")

    def finish(self, forecast: Forecast) -> Forecast:
        """Return a forecast as the call's result.

        Raises
        ------
        ValueError
            If the number of steps or balls differs from the request.
        """
        objects, steps = forecast.positions.shape[:2]
        for name, found, asked in (
            ("steps", steps, self.horizon),
            ("objects", objects, self.num_objects),
        ):
            require(asked in (None, found), f"there are {found} {name} instead of {asked}")
        return replace(forecast, warnings=(*self.warnings, *forecast.warnings))


def predict(
    frames: Frames,
    final_frame: Frame | None,
    options: ForecastOptions,
    warnings: tuple[str, ...] = (),
) -> Call[Forecast]:
    """Send frames as file parts; options that are None are left to the service."""
    return _forecast_call("/predict", frames, final_frame, options, warnings)


def predict_stream(
    frames: Frames,
    final_frame: Frame | None,
    options: ForecastOptions,
    warnings: tuple[str, ...] = (),
) -> Call[Forecast]:
    """Ask as ``predict`` does; the answer is a stream of events (``rollcast.client.stream``)."""
    return _forecast_call("/predict/stream", frames, final_frame, options, warnings)


def _forecast_call(
    path: str,
    frames: Frames,
    final_frame: Frame | None,
    options: ForecastOptions,
    warnings: tuple[str, ...],
) -> Call[Forecast]:
    crop, channels = options.get("crop"), options.get("channels", "rgb")
    for name in ("start_s", "camera_hz"):
        if options.get(name) is not None:
            raise InvalidArgumentError(f"{name} is for a clip, given as the path of a video")
    horizon, number = _whole("horizon", options), _whole("num_objects", options)
    balls = options.get("balls")
    prompts = None if balls is None else prompts_of(balls)
    fields = {
        "model": options.get("model"),
        "horizon": horizon,
        "num_objects": number,
        "balls": None if prompts is None else json.dumps([dict(prompt) for prompt in prompts]),
        "scenario": options.get("scenario"),
        **_rates(options),
    }
    pictures = each(frames)
    files: list[Part] = [
        ("frames", (f"frame{index}", encoded(frame, crop, channels)))
        for index, frame in enumerate(pictures)
    ]
    paths = [os.fspath(frame) for frame in pictures if isinstance(frame, str | os.PathLike)]
    if len(paths) == len(pictures):
        warnings = (*warnings, *numbering_warnings(paths))
    if final_frame is not None:
        files.append(("final_frame", ("final_frame", encoded(final_frame, crop, channels))))
    call = Call(
        "POST",
        path,
        lambda body: call.finish(Forecast.from_response(PredictResponse.model_validate_json(body))),
        fields={name: str(value) for name, value in fields.items() if value is not None},
        files=files,
        horizon=horizon,
        num_objects=number if prompts is None else len(prompts),
        advise=_advice,
        warnings=warnings,
    )
    return call


def _rates(options: ForecastOptions) -> dict[str, float | None]:
    rates = {"frame_rate": options.get("frame_rate"), "step_rate": options.get("step_rate")}
    return {name: None if rate is None else number(name, rate) for name, rate in rates.items()}


def session(options: ForecastOptions) -> Call[Forecast]:
    """Describe the options of a session, and read its forecasts (``rollcast.client.sessions``)."""
    horizon, number = _whole("horizon", options), _whole("num_objects", options)
    fields = {
        "model": options.get("model"),
        "horizon": horizon,
        "num_objects": number,
        "scenario": options.get("scenario"),
        **_rates(options),
    }
    return Call(
        "GET",
        "/stream",
        lambda body: Forecast.from_response(PredictResponse.model_validate_json(body)),
        json={name: value for name, value in fields.items() if value is not None},
        horizon=horizon,
        num_objects=number,
        advise=_advice,
    )


def detect(
    frames: Frames,
    model: str,
    min_score: float,
    refine_still: bool,
    crop: Crop | None,
    channels: Channels,
) -> Call[Detections]:
    """Send frames as file parts, to learn which balls they show."""
    fields = {
        "model": model,
        "min_score": str(number("min_score", min_score)),
        "refine_still": str(bool(refine_still)).lower(),
    }
    files: list[Part] = [
        ("frames", (f"frame{index}", encoded(frame, crop, channels)))
        for index, frame in enumerate(each(frames))
    ]
    return Call(
        "POST",
        "/detect",
        lambda body: Detections.from_response(DetectResponse.model_validate_json(body)),
        fields=fields,
        files=files,
        advise=_advice,
    )


def _advice(problem: Problem) -> str:
    """Return advice on square frames if the service rejects others; empty otherwise."""
    is_of_frames = (problem.field or "").partition("[")[0] in {"frames", "final_frame"}
    if not is_of_frames or "square" not in (problem.expected or ""):
        return ""
    return (
        'crop="square" cuts the middle out of every frame; with balls=[(x, y)], or a model for any '
        "number of balls, frames may be rectangles"
    )


def simulate(
    scenario: Scenario | None,
    include_frames: bool,
    include_surface: bool,
    options: SimulationOptions,
) -> Call[Simulation]:
    """Ask for a scene; options that are None are left to the service."""
    scene = options.get("scene")
    numbers = ("seed", "num_objects", "steps", "start_step", "image_size")
    body: dict[str, Any] = {
        "scenario": scenario,
        **{name: _whole(name, options) for name in numbers},
        "textured": options.get("textured"),
        "scene": scene.model_dump(mode="json") if isinstance(scene, Scene) else scene,
        "include_frames": include_frames,
        "include_surface": include_surface or None,  # older services do not know it
    }

    def read(content: bytes | bytearray) -> Simulation:
        found = Simulation.from_response(SimulateResponse.model_validate_json(content))
        require(len(found.times_s) == body["steps"], f"there are {len(found.times_s)} steps")
        require(found.frames is not None or not include_frames, "there are no frames")
        require(found.surface is not None or not include_surface, "there is no surface")
        return found

    return Call(
        "POST",
        "/simulate",
        read,
        json={name: value for name, value in body.items() if value is not None},
        max_bytes=MAX_SIMULATION_BYTES,
    )


def models() -> Call[list[ModelEntry]]:
    """List every version of every model."""
    return Call("GET", "/models", lambda body: ModelList.model_validate_json(body).models)


def model(name: str, version: Integer | None) -> Call[ModelDetail]:
    """Return one version of a model, by default the default one, with its card."""
    try:
        path = f"/models/{quote(name, safe='')}"
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"name is {name!r}, expected the name of a model") from error
    if version is not None:
        path += f"/versions/{_whole('version', {'version': version})}"
    return Call("GET", path, ModelDetail.model_validate_json)


def health() -> Call[Health]:
    """Ask whether forecasts are answered."""
    return Call("GET", "/health/ready", Health.model_validate_json, answers=(200, 503))


def _whole(name: str, options: Mapping[str, Any]) -> int | None:
    value: SupportsIndex | None = options.get(name)
    if value is None:
        return None
    try:
        return operator.index(value)
    except TypeError as error:
        raise InvalidArgumentError(f"{name} is {value!r}, expected a whole number") from error


def checked_rate(name: str, value: object) -> float:
    """Return a number of frames a second.

    Raises
    ------
    InvalidArgumentError
        When it is none, or the service takes no such rate.
    """
    rate = number(name, value)
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        expected = f"{MIN_RATE_HZ:g} to {MAX_RATE_HZ} frames a second"
        raise InvalidArgumentError(f"{name} is {value!r}, expected {expected}")
    return rate


def number(name: str, value: object) -> float:
    """Return an argument as a number; raises InvalidArgumentError when it is none."""
    if isinstance(value, str | bytes):
        raise InvalidArgumentError(f"{name} is {value!r}, expected a number")
    try:
        return float(value)  # pyright: ignore[reportArgumentType] - that is the question
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidArgumentError(f"{name} is {value!r}, expected a number") from error


def _plain(value: object) -> object:
    """Convert NumPy numbers and arrays to JSON types."""
    if isinstance(value, np.ndarray | np.generic):
        return np.asarray(cast("Any", value)).tolist()
    raise TypeError(f"{type(value).__name__} cannot be encoded as JSON")
