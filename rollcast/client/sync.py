# Written by `python -m tests.rollcast.write_sync_client` (`make format`).
# The source is aio.py: change that.
"""The client: its methods, the transport, and the forecast that arrives step by step."""

from collections.abc import Callable, Generator, Iterable, Mapping
from functools import partial
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, Unpack, cast, overload

import httpx2
import numpy as np

from rollcast.client import calls
from rollcast.client._sync import Connections, gather_limited, to_thread, with_retries, within
from rollcast.client.answers import MAX_ANSWER_BYTES, check_size, translated
from rollcast.client.calls import Call, ForecastOptions, Integer, SimulationOptions
from rollcast.client.clips import Clip, is_clip, named_model, read_clip
from rollcast.client.connection import Target, checked_timeout
from rollcast.client.deadline import Deadline
from rollcast.client.images import Crop, Frame, Frames
from rollcast.client.prompts import BallPoints
from rollcast.client.results import Detections, Forecast, ForecastStep, Simulation, Surface
from rollcast.client.sessions import SessionTransport
from rollcast.client.stream import StreamAssembler
from rollcast.client.sync_session import Session
from rollcast.errors import InvalidArgumentError
from rollcast.frames import Channels
from rollcast.scene import Domain, Scenario, Scene
from rollcast.schemas import AUTO_MODEL, DEFAULT_HORIZON, Health, ModelDetail, ModelEntry
from rollcast.trajectory import OBSERVED_FRAMES

T = TypeVar("T")


class Client:
    """Client of the service. Close it, or use it as a context manager.

    Every exception of a call is a ``rollcast.errors.ClientError``, unless frames cannot be read: an
    ``UnreachableError`` when the service does not answer, a ``ProblemError`` with the problem
    document when it refuses, an ``UnexpectedAnswerError`` when the answer is not a valid one.
    Connections are kept open and reused, so one client for many calls is faster than many clients.

    Parameters
    ----------
    base_url
        Address of the service; by default ``ROLLCAST_URL`` of the environment, else
        ``http://127.0.0.1:8000``. Redirections are not followed. The environment's proxies
        (``HTTP_PROXY``, ``HTTPS_PROXY``, ``ALL_PROXY``, ``NO_PROXY``) are used; errors name them.
    timeout_s
        Longest time that a call takes, seconds: connection, answer, retries and the waits between
        them. In a stream the time between the reading of two steps does not count.
    retries
        Number of times that a call is sent again, after growing waits and after the Retry-After of
        the answer: when the connection was lost, the service is overloaded or not ready, or a proxy
        cannot reach it. A Retry-After that ends after ``timeout_s``, or is longer than a minute, is
        not waited for: the error is raised at once, with ``retry_after_s``.
    api_key
        API key, for services that ask for one; by default ``ROLLCAST_API_KEY`` of the environment,
        and none when it is empty.
    transport
        Transport of the requests; by default the network. ``rollcast.client.testing`` has one for
        tests. Inside a single read or write, ``timeout_s`` depends on it.

    Raises
    ------
    rollcast.errors.InvalidArgumentError
        When an argument, or a variable of the environment, cannot be used.
    """

    def __init__(
        self,
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        api_key: str | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self._target = Target.resolve(base_url, api_key, over_network=transport is None)
        self._transport = transport
        self._timeout_s = checked_timeout(timeout_s)
        self._connections = Connections(self._target, transport)
        self._retries = retries

    @property
    def base_url(self) -> str:
        """Address of the service."""
        return str(self._target.base_url)

    def predict(
        self,
        frames: Frames | Clip,
        *,
        horizon: Integer | None = None,
        model: str = AUTO_MODEL,
        final_frame: Frame | None = None,
        num_objects: Integer | None = None,
        balls: BallPoints | None = None,
        scenario: Domain | None = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Crop | None = None,
        start_s: float | None = None,
        channels: Channels = "rgb",
        camera_hz: float | None = None,
    ) -> Forecast:
        """Forecast the paths of the balls.

        Parameters
        ----------
        frames
            The four observed frames in order, each a ``Frame``. They are sent as they are; models
            for a fixed number of balls read square ones (``crop``). Or the path of a video
            (extra ``video``), a folder of images or a TIFF file, of which the four frames from
            ``start_s`` on are read at the model's frame rate.
        horizon
            Steps; by default 40, with a final frame as many as its model is made for.
        model
            "auto", NAME or NAME@VERSION.
        final_frame
            A later frame, for models that read one: that of the last step.
        num_objects
            Number of balls; default: that of the named model, with "auto" one. A model for any
            number of balls follows the moving balls by default.
        balls
            Prompts that select balls: a point of the last observed frame for each, in the order of
            the forecast's objects. Points are (x, y), (x, y, radius) or ``BallPrompt``, in
            pixels of the frames that are sent, of a video in pixels of its pictures. With "auto" a
            model for any number of balls answers.
        scenario
            Narrows the choice of "auto" to models made for it, or for "footage" of a set-up of
            one's own.
        frame_rate
            Frames a second; by default the rate that the model was trained on.
        step_rate
            Steps a second of the forecast; by default ``frame_rate``.
        crop
            "square" cuts the largest square out of the middle of every frame; positions are then
            pixels of that square. Videos are sent whole with ``balls``, to a named model for any
            number of balls, and with "auto" where the service has such a model; otherwise they are
            cropped, to the square of the set-up that the named model was trained on, if it has one,
            else to the square in the middle, which a warning reports.
        start_s
            Time of the first frame in the video, seconds; by default 0.
        channels
            Order of the channels of arrays and tensors: "bgr" for those of OpenCV. Files and Pillow
            images state theirs.
        camera_hz
            Frames a second that the camera took, where the video does not tell or is slow motion,
            or of a folder of images.

        Raises
        ------
        rollcast.errors.ClientError
            When the call fails.
        rollcast.errors.FootageError, rollcast.errors.MissingExtraError
            When a video cannot be read.
        TypeError, ValueError, OSError
            When a frame cannot be converted or read.
        """
        options = ForecastOptions(
            horizon=horizon,
            model=model,
            num_objects=num_objects,
            balls=balls,
            scenario=scenario,
            frame_rate=frame_rate,
            step_rate=step_rate,
            crop=crop,
            start_s=start_s,
            channels=channels,
            camera_hz=camera_hz,
        )
        return self._run(self._forecast(calls.predict, frames, final_frame, options))

    def predict_stream(
        self,
        frames: Frames | Clip,
        *,
        final_frame: Frame | None = None,
        **options: Unpack[ForecastOptions],
    ) -> "ForecastStream":
        """Forecast like ``predict``, and yield every step as soon as it is computed.

        The request is sent when the first step is requested or the context is entered. It is
        retried (``retries``) until the first step has arrived, and not after it.

        Parameters
        ----------
        frames, final_frame, options
            As for ``predict``.
        """
        return ForecastStream(self, frames, final_frame, options)

    def session(
        self,
        *,
        horizon: Integer | None = None,
        model: str = AUTO_MODEL,
        num_objects: Integer | None = None,
        scenario: Domain | None = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Crop | None = None,
        channels: Channels = "rgb",
    ) -> Session:
        """Open a session for a loop: one frame a tick is sent, the service keeps the last four.

        The connection is opened when the context is entered, and retried (``retries``) until the
        service has accepted the options.

        Parameters
        ----------
        horizon, model, num_objects, scenario, frame_rate, step_rate, crop, channels
            As for ``predict``, for all forecasts of the session.

        Raises
        ------
        rollcast.errors.InvalidArgumentError
            When an argument cannot be used, or the client has a transport that opens no sessions:
            they are WebSockets, and of the transports of httpx2 only ``FakeService`` has them.
        """
        transport = self._transport
        if not (transport is None or isinstance(transport, SessionTransport)):
            raise InvalidArgumentError(
                f"the transport {type(transport).__name__} opens no sessions, which are "
                "WebSockets: use a client without a transport of its own, or FakeService"
            )
        options = ForecastOptions(
            horizon=horizon,
            model=model,
            num_objects=num_objects,
            scenario=scenario,
            frame_rate=frame_rate,
            step_rate=step_rate,
        )
        return Session(
            self._target,
            calls.session(options),
            crop,
            channels,
            timeout_s=self._timeout_s,
            retries=self._retries,
            transport=transport,
        )

    def predict_many(
        self,
        sequences: Iterable[Frames | Clip],
        *,
        final_frames: Iterable[Frame] | None = None,
        concurrency: int = 4,
        **options: Unpack[ForecastOptions],
    ) -> list[Forecast]:
        """Forecast many sequences, several at once, and return the forecasts in order.

        The first failure ends all calls and is raised.

        Parameters
        ----------
        sequences
            Observed frames, as for ``predict``.
        final_frames
            A final frame for each of them.
        concurrency
            Number of calls at once, at least one. The service answers 429 to more calls than it has
            cores and places in its queue.
        options
            As for ``predict``, the same for all.

        Raises
        ------
        ValueError
            When ``concurrency`` is less than one or a sequence lacks its final frame.
        rollcast.errors.ClientError
            When a call fails.
        """
        if concurrency < 1:
            raise ValueError(f"concurrency is {concurrency}, expected at least 1")
        sequences = list(sequences)
        finals = [None] * len(sequences) if final_frames is None else list(final_frames)
        return gather_limited(
            [
                partial(self.predict, frames, final_frame=final, **options)
                for frames, final in zip(sequences, finals, strict=True)
            ],
            concurrency,
        )

    def detect(
        self,
        frames: Frames,
        *,
        model: str = AUTO_MODEL,
        min_score: float = 0.25,
        refine_still: bool = True,
        crop: Crop | None = None,
        channels: Channels = "rgb",
    ) -> Detections:
        """Find all balls in four frames, moving or not, without a forecast.

        Parameters
        ----------
        frames
            Four frames in order, each a ``Frame``: rectangles of any size.
        model
            "auto", NAME or NAME@VERSION of a model for any number of balls.
        min_score
            Score, 0 to 1, of the coarse detector from which on a candidate is returned.
        refine_still
            False leaves the balls that hardly move where the coarse detector sees them, which
            takes less time.
        crop
            "square" cuts the largest square out of the middle of every frame.
        channels
            Order of the channels of arrays and tensors: "rgb" or "bgr".

        Raises
        ------
        rollcast.errors.ClientError
            When the call fails.
        TypeError, ValueError, OSError
            When a frame cannot be converted or read.
        """
        call = to_thread(calls.detect, frames, model, min_score, refine_still, crop, channels)
        return self._run(call)

    @overload
    def simulate(
        self,
        scenario: Scenario | None = None,
        *,
        include_frames: Literal[True] = True,
        include_surface: Literal[False] = False,
        **options: Unpack[SimulationOptions],
    ) -> Simulation[np.ndarray, None]: ...

    @overload
    def simulate(
        self,
        scenario: Scenario | None = None,
        *,
        include_frames: Literal[True] = True,
        include_surface: Literal[True],
        **options: Unpack[SimulationOptions],
    ) -> Simulation[np.ndarray, Surface]: ...

    @overload
    def simulate(
        self,
        scenario: Scenario | None = None,
        *,
        include_frames: bool = True,
        include_surface: bool = False,
        **options: Unpack[SimulationOptions],
    ) -> Simulation: ...

    def simulate(
        self,
        scenario: Scenario | None = None,
        *,
        seed: Integer | None = None,
        num_objects: Integer | None = None,
        steps: Integer = OBSERVED_FRAMES + DEFAULT_HORIZON,
        start_step: Integer | None = None,
        image_size: Integer = 128,
        textured: bool | None = None,
        include_frames: bool = True,
        include_surface: bool = False,
        scene: Scene | Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Simulate a scene.

        Parameters
        ----------
        scenario, seed
            Needed unless ``scene`` has them. The same seed gives the same bytes.
        num_objects
            Number of balls, by default that of ``scene``, else one.
        steps
            Frames, at the frame rate of simulations.
        start_step
            First step, counted from the start of the simulation; by default the test start.
        image_size
            Side of the frames, pixels.
        textured
            By default true for one ball.
        include_frames
            False leaves the frames out.
        include_surface
            True adds the heights of the ground.
        scene
            A scene that came back, or any of the fields of ``rollcast.scene.Scene``; the others are
            sampled.

        Raises
        ------
        rollcast.errors.ClientError
            When the call fails.
        """
        options = SimulationOptions(
            seed=seed,
            num_objects=num_objects,
            steps=steps,
            start_step=start_step,
            image_size=image_size,
            textured=textured,
            scene=scene,
        )
        return self._run(calls.simulate(scenario, include_frames, include_surface, options))

    def models(self) -> list[ModelEntry]:
        """List every version of every model, with the reason if it cannot be used."""
        return self._run(calls.models())

    def model(self, name: str, version: Integer | None = None) -> ModelDetail:
        """Return one version of a model, by default the default one, with its card."""
        return self._run(calls.model(name, version))

    def health(self) -> Health:
        """Return whether the service answers forecasts, and why not."""
        return self._run(calls.health())

    def close(self) -> None:
        """Close the connections. A call after that opens new ones."""
        self._connections.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _forecast(
        self,
        make: Callable[..., Call[Forecast]],
        frames: Frames | Clip,
        final_frame: Frame | None,
        options: ForecastOptions,
    ) -> Call[Forecast]:
        """Return the call for frames or for a video."""
        if not is_clip(frames):
            return to_thread(make, frames, final_frame, options)
        name = named_model(options)
        models = self.models() if name is None else [self.model(*name)]
        final = final_frame is not None
        seen, rest, warnings = to_thread(read_clip, frames, options, models, final_frame=final)
        return to_thread(make, seen, final_frame, rest, warnings)

    def _run(self, call: Call[T]) -> T:
        http, deadline = self._connections.client(), Deadline(self._timeout_s)
        request = call.request(http, deadline)
        with translated(request, self._target.proxy), within(deadline):
            ask = partial(self._ask, call, http, request, deadline)
            return with_retries(ask, self._retries, deadline)

    def _ask(
        self,
        call: Call[T],
        http: httpx2.Client,
        request: httpx2.Request,
        deadline: Deadline,
    ) -> T:
        with translated(request, self._target.proxy):
            response = http.send(request, stream=True)
            try:
                content = self._content(response, call.max_bytes, deadline)
            finally:
                response.close()
        return to_thread(call.result, response, content)

    def _content(self, response: httpx2.Response, limit: int, deadline: Deadline) -> bytearray:
        content = bytearray()
        check_size(response, 0, limit)
        for chunk in response.iter_bytes():
            content += chunk
            check_size(response, len(content), limit)
            deadline.check()
        return content

    def _begin(
        self, frames: Frames | Clip, final_frame: Frame | None, options: ForecastOptions
    ) -> "_Opened":
        call = self._forecast(calls.predict_stream, frames, final_frame, options)
        http, deadline = self._connections.client(), Deadline(self._timeout_s)
        request = call.request(http, deadline)
        with translated(request, self._target.proxy), within(deadline):
            begin = partial(self._open, call, http, request, deadline)
            return with_retries(begin, self._retries, deadline)

    def _open(
        self,
        call: Call[Forecast],
        http: httpx2.Client,
        request: httpx2.Request,
        deadline: Deadline,
    ) -> "_Opened":
        """Send a request and wait until the first step of its answer has arrived."""
        with translated(request, self._target.proxy):
            response = http.send(request, stream=True)
            try:
                if response.status_code != 200:
                    content = self._content(response, MAX_ANSWER_BYTES, deadline)
                    raise call.failure(response, content)
                opened = _Opened(response, call, deadline, self._target)
            except BaseException:
                response.close()
                raise
            try:
                opened.look_ahead()
            except BaseException:
                opened.close()
                raise
            return opened


class ForecastStream:
    """A forecast whose steps are iterated over as they arrive, from step 0, t = 0, on.

    Leaving its context closes the connection, and the service stops computing the remaining steps.
    Without a context, read it to its end or close it.
    """

    def __init__(
        self,
        client: Client,
        frames: Frames | Clip,
        final_frame: Frame | None,
        options: ForecastOptions,
    ) -> None:
        self._begin = partial(
            client._begin,  # pyright: ignore[reportPrivateUsage] - the two are one
            frames,
            final_frame,
            options,
        )
        self._opened: _Opened | None = None
        self._closed = False

    @property
    def forecast(self) -> Forecast:
        """All of the forecast, once its last step has been read.

        Raises
        ------
        RuntimeError
            When it has not been read to its end.
        """
        if self._opened is None or (forecast := self._opened.forecast) is None:
            raise RuntimeError("the forecast is complete after its last step has been read")
        return forecast

    def close(self) -> None:
        """Close the connection; nothing more arrives."""
        self._closed = True
        if self._opened is not None:
            self._opened.close()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> ForecastStep:
        try:
            step = None if self._closed else (self._open()).next_step()
        except BaseException:
            self.close()
            raise
        if step is None:
            self.close()
            raise StopIteration
        return step

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _open(self) -> "_Opened":
        if self._opened is None:
            self._opened = self._begin()
        return self._opened


class _Opened:
    """A stream that has begun to answer."""

    def __init__(
        self,
        response: httpx2.Response,
        call: Call[Forecast],
        deadline: Deadline,
        target: Target,
    ) -> None:
        self._response, self._deadline, self._target = response, deadline, target
        self._assembler = StreamAssembler(response, call)
        self._events = cast(Generator[httpx2.ServerSentEvent], iter(httpx2.EventSource(response)))
        self._ahead: ForecastStep | None = None

    @property
    def forecast(self) -> Forecast | None:
        return self._assembler.forecast

    def look_ahead(self) -> None:
        """Wait for the first step, which is returned as the next one."""
        self._ahead = self._arrived()

    def next_step(self) -> ForecastStep | None:
        """Return the next step, None after the last."""
        if self._ahead is not None:
            step, self._ahead = self._ahead, None
            return step
        with translated(self._response.request, self._target.proxy), within(self._deadline):
            return self._arrived()

    def close(self) -> None:
        self._events.close()
        self._response.close()

    def _arrived(self) -> ForecastStep | None:
        if self.forecast is not None:
            return None
        for event in self._events:
            self._deadline.check()
            step = self._assembler.take(event)
            if step is not None:
                return step
            if self.forecast is not None:
                return None
        raise self._assembler.ended()
