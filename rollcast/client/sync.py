# Written by `python -m tests.rollcast.write_sync_client` (`make format`) from aio.py: change that.
"""The client: its methods, the transport, and the forecast that arrives step by step."""

from collections.abc import Generator, Iterable, Mapping
from functools import partial
from types import TracebackType
from typing import Any, Self, TypeVar, Unpack, cast

import httpx2

from rollcast.client import calls
from rollcast.client._sync import off_the_loop, repeated, side_by_side
from rollcast.client.calls import Call, ForecastOptions, failure, reaching
from rollcast.client.images import Crop, Frame, Frames
from rollcast.client.results import Forecast, ForecastStep, Simulation
from rollcast.client.stream import Arrivals
from rollcast.scene import Domain, Scenario, Scene
from rollcast.schemas import AUTO_MODEL, Health, ModelDetail, ModelEntry
from rollcast.trajectory import OBSERVED_FRAMES

T = TypeVar("T")


class Client:
    """The service as an object. Close it, or use it as a context manager.

    Every method raises ``rollcast.errors.UnreachableError`` when the service does not answer, and
    a ``rollcast.errors.ProblemError`` that carries the problem document when it refuses.
    Connections are kept and used again, so one client for many calls is faster than many clients.

    Parameters
    ----------
    base_url
        Address of the service.
    timeout_s
        Seconds to wait for an answer, or for the next step of a stream.
    retries
        How often a call is sent again, after a growing wait and not before the service asks for it
        (Retry-After): when the connection was lost, when the service is full or not ready, and when
        what stands before it could not pass it on. Calls change nothing, so asking twice is safe.
    api_key
        Sent with every call, for services that ask for one.
    transport
        Sends the requests; by default over the network. ``rollcast.client.testing`` has one for
        tests.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        api_key: str | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        headers = {} if api_key is None else {"Authorization": f"Bearer {api_key}"}
        self._http = httpx2.Client(
            base_url=base_url, timeout=timeout_s, headers=headers, transport=transport
        )
        self._retries = retries

    def predict(
        self,
        frames: Frames,
        *,
        horizon: int | None = None,
        model: str = AUTO_MODEL,
        final_frame: Frame | None = None,
        final_step: int | None = None,
        objects: int | None = None,
        scenario: Domain | None = None,
        frame_rate: float | None = None,
        crop: Crop | None = None,
    ) -> Forecast:
        """Forecast where the balls go.

        Parameters
        ----------
        frames
            The four observed frames in order: RGB uint8 arrays [height, width, 3], Pillow images or
            paths; square, or cropped.
        horizon
            Steps; by default 40, with a final frame as many as its model is made for.
        model
            "auto", NAME or NAME@VERSION.
        final_frame, final_step
            A later frame, for models that read one, and the step that it shows.
        objects
            Number of balls; by default the named model's, with "auto" one.
        scenario
            Narrows the choice of "auto" to models made for it, or for "footage" of a set-up of
            one's own.
        frame_rate
            Frames a second; by default as many as the model was trained on.
        crop
            "square" cuts the largest square out of the middle of every frame; positions are then
            pixels of that square.
        """
        options = ForecastOptions(
            horizon=horizon,
            model=model,
            final_step=final_step,
            objects=objects,
            scenario=scenario,
            frame_rate=frame_rate,
            crop=crop,
        )
        return self._run(off_the_loop(calls.predict, frames, final_frame, options))

    def predict_stream(
        self,
        frames: Frames,
        *,
        final_frame: Frame | None = None,
        **options: Unpack[ForecastOptions],
    ) -> "ForecastStream":
        """Forecast as ``predict`` does, and get every step as soon as it is computed.

        Nothing is sent before the first step is asked for, or the context entered. A call is sent
        again (``retries``) until its first step is there, and not after it.

        Parameters
        ----------
        frames, final_frame, options
            As for ``predict``.
        """
        return ForecastStream(self, frames, final_frame, options)

    def predict_many(
        self,
        sequences: Iterable[Frames],
        *,
        final_frames: Iterable[Frame] | None = None,
        concurrency: int = 4,
        **options: Unpack[ForecastOptions],
    ) -> list[Forecast]:
        """Forecast many sequences, some at once, and return the forecasts in their order.

        The first that fails ends them all, and its exception is raised.

        Parameters
        ----------
        sequences
            Observed frames, as for ``predict``.
        final_frames
            One for each of them.
        concurrency
            How many calls are made at once, at least one. More than the service has cores and
            places in its queue are told to come again.
        options
            As for ``predict``, the same for all.

        Raises
        ------
        ValueError
            When ``concurrency`` is less than one or a sequence lacks its final frame.
        """
        if concurrency < 1:
            raise ValueError(f"concurrency is {concurrency}, expected at least 1")
        sequences = list(sequences)
        finals = [None] * len(sequences) if final_frames is None else list(final_frames)
        return side_by_side(
            [
                partial(self.predict, frames, final_frame=final, **options)
                for frames, final in zip(sequences, finals, strict=True)
            ],
            concurrency,
        )

    def simulate(
        self,
        scenario: Scenario | None = None,
        *,
        seed: int | None = None,
        objects: int | None = None,
        steps: int = OBSERVED_FRAMES + 40,
        start_step: int | None = None,
        image_size: int = 128,
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
        objects
            Number of balls, by default that of ``scene``, else one.
        steps
            Frames, 40 a second.
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
        """
        fields = {
            "objects": objects,
            "steps": steps,
            "start_step": start_step,
            "image_size": image_size,
            "textured": textured,
            "include_frames": include_frames,
            "include_surface": include_surface or None,  # older services do not know it
        }
        return self._run(calls.simulate(scenario, seed, scene, fields))

    def models(self) -> list[ModelEntry]:
        """List every version of every model, refused ones with the reason."""
        return self._run(calls.models())

    def model(self, name: str, version: int | None = None) -> ModelDetail:
        """Return one version of a model, by default the default one, with its card."""
        return self._run(calls.model(name, version))

    def health(self) -> Health:
        """Return whether forecasts are answered, and why not."""
        return self._run(calls.health())

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self, call: Call[T]) -> T:
        return repeated(partial(self._ask, call, call.request(self._http)), self._retries)

    def _ask(self, call: Call[T], request: httpx2.Request) -> T:
        with reaching(request):
            response = self._http.send(request)
        return off_the_loop(call.result, response)

    def _begin(
        self, frames: Frames, final_frame: Frame | None, options: ForecastOptions
    ) -> "_Opened":
        call = off_the_loop(calls.predict_stream, frames, final_frame, options)
        return repeated(partial(self._open, call.request(self._http)), self._retries)

    def _open(self, request: httpx2.Request) -> "_Opened":
        """Send a request and wait until the first step of its answer is there."""
        with reaching(request):
            response = self._http.send(request, stream=True)
        try:
            if response.status_code != 200:
                with reaching(request):
                    response.read()
                raise failure(response)
            opened = _Opened(response)
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

    Leaving its context closes the connection, and the service stops computing what is not there
    yet. Without a context, read it to its end or close it.
    """

    def __init__(
        self,
        client: Client,
        frames: Frames,
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
            raise RuntimeError("the forecast is there after its last step has been read")
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

    def __init__(self, response: httpx2.Response) -> None:
        self._response = response
        self._arrivals = Arrivals(response)
        self._events = cast(Generator[httpx2.ServerSentEvent], iter(httpx2.EventSource(response)))
        self._ahead: ForecastStep | None = None

    @property
    def forecast(self) -> Forecast | None:
        return self._arrivals.forecast

    def look_ahead(self) -> None:
        """Wait for the first step, which is returned as the next one."""
        self._ahead = self.next_step()

    def next_step(self) -> ForecastStep | None:
        """Return the next step, None after the last."""
        if self._ahead is not None:
            step, self._ahead = self._ahead, None
            return step
        if self.forecast is not None:
            return None
        with reaching(self._response.request):
            for event in self._events:
                step = self._arrivals.take(event)
                if step is not None:
                    return step
                if self.forecast is not None:
                    return None
        raise self._arrivals.broken_off()

    def close(self) -> None:
        self._events.close()
        self._response.close()
