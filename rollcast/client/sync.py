"""The client that waits for its answers."""

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, TypeVar

import httpx2
from tenacity import Retrying, retry_if_exception, stop_after_attempt

from rollcast.client import calls
from rollcast.client.calls import Call
from rollcast.client.images import Crop, Frame
from rollcast.client.results import Forecast, Simulation
from rollcast.client.retries import may_pass, wait_s
from rollcast.errors import UnreachableError
from rollcast.http import AUTO_MODEL, Health, ModelDetail, ModelEntry
from rollcast.scene import Scenario, Scene
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

T = TypeVar("T")


class Client:
    """The service as an object. Close it, or use it in a ``with`` statement.

    Every method raises ``rollcast.errors.UnreachableError`` when the service does not answer, and
    a ``rollcast.errors.ProblemError`` that carries the problem document when it refuses.

    Parameters
    ----------
    base_url
        Address of the service.
    timeout_s
        Seconds to wait for an answer.
    retries
        How often a call is sent again, after a growing wait and not before the service asks for it
        (Retry-After): when the connection was lost, when the service is full or not ready, and when
        what stands before it could not pass it on. Calls change nothing, so asking twice is safe.
    transport
        Sends the requests; by default over the network.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self._http = httpx2.Client(base_url=base_url, timeout=timeout_s, transport=transport)
        self._retrying = Retrying(
            retry=retry_if_exception(may_pass),
            wait=wait_s,
            stop=stop_after_attempt(1 + retries),
            reraise=True,
        )

    def predict(
        self,
        frames: Sequence[Frame],
        *,
        horizon: int | None = None,
        model: str = AUTO_MODEL,
        final_frame: Frame | None = None,
        final_step: int | None = None,
        objects: int | None = None,
        scenario: Scenario | None = None,
        frame_rate: float = FRAME_RATE_HZ,
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
            Narrows the choice of "auto" to models made for it.
        frame_rate
            Frames a second.
        crop
            "square" cuts the largest square out of the middle of every frame; positions are then
            pixels of that square.
        """
        fields = {
            "horizon": horizon,
            "model": model,
            "final_step": final_step,
            "objects": objects,
            "scenario": scenario,
            "frame_rate": frame_rate,
        }
        return self._run(calls.predict(frames, final_frame, crop, fields))

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

    def __enter__(self) -> "Client":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self, call: Call[T]) -> T:
        return self._retrying(self._ask, call, call.request(self._http))

    def _ask(self, call: Call[T], request: httpx2.Request) -> T:
        try:
            response = self._http.send(request)
        except httpx2.TransportError as error:
            raise UnreachableError(f"{request.url} does not answer: {error!r}") from error
        return call.result(response)
