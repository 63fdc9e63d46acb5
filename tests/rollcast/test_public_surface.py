"""The names that users rely on, and how they are called: a change here is a change for them."""

import inspect
import re

import pytest
from inline_snapshot import snapshot
from numpy.typing import ArrayLike

import rollcast.client
import rollcast.client.testing
import rollcast.errors
from rollcast.client import Frame, Frames
from rollcast.client.calls import ForecastOptions
from tests.rollcast.write_sync_client import TARGETS, sync_client


def surface(module, names):
    """Every public class with its methods and fields, as they are called."""
    lines = []
    for name in names:
        thing = getattr(module, name)
        if not inspect.isclass(thing):
            written = without_modules(thing).replace(without_modules(Frame), "Frame")
            written = without_modules(Frame) if name == "Frame" else written
            lines.append(f"{name} = " + written.replace(" | ", "\n    | "))
            continue
        lines.append(f"class {name}{signature(thing)}")
        for member, value in inspect.getmembers(thing):
            if member.startswith("_") or hasattr(object, member):
                continue
            if not getattr(value, "__module__", "rollcast").startswith("rollcast"):
                continue  # inherited
            if isinstance(value, property):
                returned = inspect.formatannotation(value.fget.__annotations__["return"])
                lines.append(f"    {member}: {returned}")
            elif callable(value):
                awaited = "async " if inspect.iscoroutinefunction(value) else ""
                lines.append(f"    {awaited}def {member}{signature(value)}")
    return "\n".join(lines)


def signature(thing):
    """Write every parameter in a line of its own."""
    signed = inspect.signature(thing)
    lines = []
    for parameter in signed.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in lines:
            lines.append("*")
        lines.append(short(parameter))
    returned = short(inspect.formatannotation(signed.return_annotation))
    return "".join(["(", *[f"\n        {line}," for line in lines], f"\n    ) -> {returned}"])


def short(annotation):
    written = without_modules(annotation)
    for alias, name in ALIASES.items():
        written = written.replace(alias, name)
    return written


def without_modules(annotation):
    return re.sub(r"\b(typing|collections\.abc)\.", "", str(annotation))


ALIASES = {
    without_modules(Frames): "Frames",
    without_modules(Frame): "Frame",
    without_modules(ArrayLike).removesuffix("]"): "Union[ArrayLike",
    "*<class 'rollcast.client.calls.ForecastOptions'>": "Unpack[ForecastOptions]",
}
"""What is too long to read, or differs from one NumPy to the next."""


def test_the_client():
    assert surface(rollcast.client, sorted(rollcast.client.__all__)) == snapshot("""\
class AsyncClient(
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        api_key: str | None = None,
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None
    base_url: str
    async def close(
        self,
    ) -> None
    async def detect(
        self,
        frames: Frames,
        *,
        model: str = 'auto',
        min_score: float = 0.25,
        refine_still: bool = True,
        crop: Optional[Literal['square']] = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
    ) -> rollcast.client.results.Detections
    async def health(
        self,
    ) -> rollcast.schemas.Health
    async def model(
        self,
        name: str,
        version: int | numpy.integer[Any] | None = None,
    ) -> rollcast.schemas.ModelDetail
    async def models(
        self,
    ) -> list[rollcast.schemas.ModelEntry]
    async def predict(
        self,
        frames: Frames | os.PathLike[str] | str,
        *,
        horizon: int | numpy.integer[Any] | None = None,
        model: str = 'auto',
        final_frame: Frame | None = None,
        num_objects: int | numpy.integer[Any] | None = None,
        balls: Sequence[rollcast.schemas.BallPrompt | Sequence[float] | numpy.ndarray] | numpy.ndarray | None = None,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table', 'footage']] = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Optional[Literal['square']] = None,
        start_s: float | None = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
        camera_hz: float | None = None,
    ) -> rollcast.client.results.Forecast
    async def predict_many(
        self,
        sequences: Iterable[Frames | os.PathLike[str] | str],
        *,
        final_frames: Iterable[Frame] | None = None,
        concurrency: int = 4,
        **options: Unpack[ForecastOptions],
    ) -> list[rollcast.client.results.Forecast]
    def predict_stream(
        self,
        frames: Frames | os.PathLike[str] | str,
        *,
        final_frame: Frame | None = None,
        **options: Unpack[ForecastOptions],
    ) -> 'AsyncForecastStream'
    def session(
        self,
        *,
        horizon: int | numpy.integer[Any] | None = None,
        model: str = 'auto',
        num_objects: int | numpy.integer[Any] | None = None,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table', 'footage']] = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Optional[Literal['square']] = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
    ) -> rollcast.client.aio_session.AsyncSession
    async def simulate(
        self,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table']] = None,
        *,
        seed: int | numpy.integer[Any] | None = None,
        num_objects: int | numpy.integer[Any] | None = None,
        steps: int | numpy.integer[Any] = 44,
        start_step: int | numpy.integer[Any] | None = None,
        image_size: int | numpy.integer[Any] = 128,
        textured: bool | None = None,
        include_frames: bool = True,
        include_surface: bool = False,
        scene: rollcast.scene.Scene | Mapping[str, Any] | None = None,
    ) -> rollcast.client.results.Simulation
class AsyncForecastStream(
        client: rollcast.client.aio.AsyncClient,
        frames: Frames | os.PathLike[str] | str,
        final_frame: Frame | None,
        options: rollcast.client.calls.ForecastOptions,
    ) -> None
    async def close(
        self,
    ) -> None
    forecast: rollcast.client.results.Forecast
class AsyncSession(
        target: rollcast.client.connection.Target,
        call: rollcast.client.calls.Call[rollcast.client.results.Forecast],
        crop: Optional[Literal['square']],
        channels: Literal['rgb', 'bgr'],
        *,
        timeout_s: float,
        retries: int,
        transport: rollcast.client.sessions.SessionTransport | None,
    ) -> None
    async def close(
        self,
    ) -> None
    async def newest(
        self,
    ) -> rollcast.client.sessions.TickAnswer | None
    async def receive(
        self,
        timeout_s: float | None = None,
    ) -> rollcast.client.sessions.TickAnswer
    async def send(
        self,
        frame: Frame,
    ) -> int
BallPoint = rollcast.schemas.BallPrompt
    | Sequence[float]
    | numpy.ndarray
BallPoints = Sequence[rollcast.schemas.BallPrompt
    | Sequence[float]
    | numpy.ndarray]
    | numpy.ndarray
class BallPrompt(
        *,
        x: Annotated[float, Strict(strict=True)],
        y: Annotated[float, Strict(strict=True)],
        radius: Optional[Annotated[float, Strict(strict=True), FieldInfo(annotation=NoneType, required=True, metadata=[Gt(gt=0)])]] = None,
    ) -> None
    model_extra: 'Dict[str, Any] | None'
    model_fields_set: 'set[str]'
class Client(
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        api_key: str | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None
    base_url: str
    def close(
        self,
    ) -> None
    def detect(
        self,
        frames: Frames,
        *,
        model: str = 'auto',
        min_score: float = 0.25,
        refine_still: bool = True,
        crop: Optional[Literal['square']] = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
    ) -> rollcast.client.results.Detections
    def health(
        self,
    ) -> rollcast.schemas.Health
    def model(
        self,
        name: str,
        version: int | numpy.integer[Any] | None = None,
    ) -> rollcast.schemas.ModelDetail
    def models(
        self,
    ) -> list[rollcast.schemas.ModelEntry]
    def predict(
        self,
        frames: Frames | os.PathLike[str] | str,
        *,
        horizon: int | numpy.integer[Any] | None = None,
        model: str = 'auto',
        final_frame: Frame | None = None,
        num_objects: int | numpy.integer[Any] | None = None,
        balls: Sequence[rollcast.schemas.BallPrompt | Sequence[float] | numpy.ndarray] | numpy.ndarray | None = None,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table', 'footage']] = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Optional[Literal['square']] = None,
        start_s: float | None = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
        camera_hz: float | None = None,
    ) -> rollcast.client.results.Forecast
    def predict_many(
        self,
        sequences: Iterable[Frames | os.PathLike[str] | str],
        *,
        final_frames: Iterable[Frame] | None = None,
        concurrency: int = 4,
        **options: Unpack[ForecastOptions],
    ) -> list[rollcast.client.results.Forecast]
    def predict_stream(
        self,
        frames: Frames | os.PathLike[str] | str,
        *,
        final_frame: Frame | None = None,
        **options: Unpack[ForecastOptions],
    ) -> 'ForecastStream'
    def session(
        self,
        *,
        horizon: int | numpy.integer[Any] | None = None,
        model: str = 'auto',
        num_objects: int | numpy.integer[Any] | None = None,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table', 'footage']] = None,
        frame_rate: float | None = None,
        step_rate: float | None = None,
        crop: Optional[Literal['square']] = None,
        channels: Literal['rgb', 'bgr'] = 'rgb',
    ) -> rollcast.client.sync_session.Session
    def simulate(
        self,
        scenario: Optional[Literal['hemisphere', 'ellipsoid', 'heightfield', 'table']] = None,
        *,
        seed: int | numpy.integer[Any] | None = None,
        num_objects: int | numpy.integer[Any] | None = None,
        steps: int | numpy.integer[Any] = 44,
        start_step: int | numpy.integer[Any] | None = None,
        image_size: int | numpy.integer[Any] = 128,
        textured: bool | None = None,
        include_frames: bool = True,
        include_surface: bool = False,
        scene: rollcast.scene.Scene | Mapping[str, Any] | None = None,
    ) -> rollcast.client.results.Simulation
Crop = Literal['square']
class Detections(
        seen: jaxtyping.Float64[ndarray, 'balls 4 3'],
        scores: jaxtyping.Float64[ndarray, 'balls'],
        moving: jaxtyping.Float64[ndarray, 'balls'],
        visible: jaxtyping.Float64[ndarray, 'balls 4'],
        refined: jaxtyping.Bool[ndarray, 'balls'],
        frame_size: tuple[int, int],
        model: str,
    ) -> None
    def from_response(
        response: rollcast.schemas.DetectResponse,
    ) -> Self
class Forecast(
        outputs: Mapping[str, numpy.ndarray],
        covariance_source: Literal['predicted', 'empirical'],
        ellipse50_radii: jaxtyping.Float64[ndarray, 'T'],
        times_s: jaxtyping.Float64[ndarray, 'T'],
        colors: tuple[str, ...],
        scores: jaxtyping.Float64[ndarray, 'objects'] | None,
        seen: jaxtyping.Float64[ndarray, 'objects 4 3'] | None,
        object_warnings: tuple[tuple[str, ...], ...],
        motions: tuple[Literal['network', 'kinematic'], ...],
        alternatives: tuple[rollcast.schemas.AlternativeForecast | None, ...],
        model: rollcast.schemas.ModelReference,
        frame_size: tuple[int, int],
        frame_rate: float,
        step_rate: float,
        warnings: tuple[str, ...],
        timing_ms: rollcast.schemas.PredictTiming,
    ) -> None
    angular_velocities: jaxtyping.Float64[ndarray, 'objects T 3'] | None
    covariances: jaxtyping.Float64[ndarray, 'objects T 2 2']
    final_positions: jaxtyping.Float64[ndarray, 'objects 2'] | None
    def from_events(
        steps: Sequence[rollcast.schemas.StreamStep],
        done: rollcast.schemas.StreamDone,
    ) -> Self
    def from_response(
        response: rollcast.schemas.PredictResponse,
    ) -> Self
    def plot(
        self,
        frames: Frames | None = None,
        *,
        times_s: Sequence[float] | None = None,
        crop: Optional[Literal['square']] = None,
        panels: int = 6,
    ) -> PIL.Image.Image
    positions: jaxtyping.Float64[ndarray, 'objects T 2']
    def save(
        self,
        path: pathlib.Path | str,
        frames: Frames | None = None,
        *,
        times_s: Sequence[float] | None = None,
        crop: Optional[Literal['square']] = None,
    ) -> None
    def to_dataframe(
        self,
    ) -> 'DataFrame'
    def to_json(
        self,
    ) -> str
class ForecastStep(
        step: int,
        time_s: float,
        ellipse50_radius: float,
        outputs: Mapping[str, numpy.ndarray],
    ) -> None
    angular_velocities: jaxtyping.Float64[ndarray, 'objects 3'] | None
    covariances: jaxtyping.Float64[ndarray, 'objects 2 2']
    def from_event(
        event: rollcast.schemas.StreamStep,
    ) -> Self
    positions: jaxtyping.Float64[ndarray, 'objects 2']
class ForecastStream(
        client: rollcast.client.sync.Client,
        frames: Frames | os.PathLike[str] | str,
        final_frame: Frame | None,
        options: rollcast.client.calls.ForecastOptions,
    ) -> None
    def close(
        self,
    ) -> None
    forecast: rollcast.client.results.Forecast
Frame = numpy.ndarray
    | PIL.Image.Image
    | os.PathLike[str]
    | str
    | bytes
    | bytearray
    | memoryview
    | rollcast.frames.SupportsRead
    | rollcast.frames.SupportsArray
Frames = Sequence[Frame]
    | numpy.ndarray
    | rollcast.client.images.FrameTensor
class Session(
        target: rollcast.client.connection.Target,
        call: rollcast.client.calls.Call[rollcast.client.results.Forecast],
        crop: Optional[Literal['square']],
        channels: Literal['rgb', 'bgr'],
        *,
        timeout_s: float,
        retries: int,
        transport: rollcast.client.sessions.SessionTransport | None,
    ) -> None
    def close(
        self,
    ) -> None
    def newest(
        self,
    ) -> rollcast.client.sessions.TickAnswer | None
    def receive(
        self,
        timeout_s: float | None = None,
    ) -> rollcast.client.sessions.TickAnswer
    def send(
        self,
        frame: Frame,
    ) -> int
class Simulation(
        frames: ~FramesT,
        positions: jaxtyping.Float64[ndarray, 'objects steps 2'],
        angular_velocities: jaxtyping.Float64[ndarray, 'objects steps 3'],
        times_s: jaxtyping.Float64[ndarray, 'steps'],
        radii_px: jaxtyping.Float64[ndarray, 'objects'],
        colors: tuple[Literal['red', 'green', 'blue', 'yellow', 'magenta', 'cyan', 'orange', 'white'], ...],
        scene: rollcast.scene.Scene,
        start_step: int,
        frame_size: tuple[int, int],
        frame_rate: float,
        surface: ~SurfaceT,
    ) -> None
    def from_response(
        response: rollcast.schemas.SimulateResponse,
    ) -> 'Simulation'
    def plot(
        self,
        *,
        panels: int = 6,
    ) -> PIL.Image.Image
    def to_dataframe(
        self,
    ) -> 'DataFrame'
class Surface(
        heights_m: jaxtyping.Float64[ndarray, 'n n'],
        half_width_m: float,
    ) -> None
class TickAnswer(
        tick: int,
        status: Literal['open', 'collecting', 'forecast', 'superseded', 'refused'],
        latency_ms: float,
        forecast: rollcast.client.results.Forecast | None,
        error: rollcast.errors.ProblemError | None,
    ) -> None\
""")


def test_the_fake_service():
    names = rollcast.client.testing.__all__
    assert surface(rollcast.client.testing, names) == snapshot("""\
class FakeService(
        positions: Union[ArrayLike, NoneType] = None,
        *,
        variance_px2: float = 1.0,
        problem: rollcast.schemas.Problem | None = None,
    ) -> None
    def open_session(
        self,
        message: str,
    ) -> rollcast.client.fake_session.FakeSession
class RecordedRequest(
        method: str,
        path: str,
        fields: Mapping[str, Any],
        frames: Sequence[bytes] = (),
        final_frame: bytes | None = None,
    ) -> None\
""")


def test_the_exceptions():
    kinds = [kind for _, kind in inspect.getmembers(rollcast.errors, inspect.isclass)]
    tree = inspect.getclasstree([kind for kind in kinds if issubclass(kind, Exception)])

    def names(branch, depth=0):
        for node in branch:
            if isinstance(node, tuple):
                yield "  " * depth + node[0].__name__
            else:
                yield from names(node, depth + 1)

    assert "\n".join(names(tree)) == snapshot("""\
Exception
  RollcastError
    ClientError
      InvalidArgumentError
      ProblemError
        BadRequestError
          AuthError
        OverloadedError
        ServerError
      UnexpectedAnswerError
      UnreachableError
        RequestTimeoutError
    DatasetError
    FootageError
      CropError
      FootageEndedError
      FrameError
    MissingExtraError
    SceneParametersError
    SceneRejectedError
ImportError
  MissingExtraError
TimeoutError
  RequestTimeoutError
ValueError
  FrameError
  InvalidArgumentError\
""")


def test_both_clients_have_the_same_methods():
    def methods(kind):
        return {
            name: str(inspect.signature(value))
            .replace("Async", "")
            .replace("aio_session", "sync_session")
            for name, value in inspect.getmembers(kind, inspect.isfunction)
            if not name.startswith("_")
        }

    assert methods(rollcast.client.Client) == methods(rollcast.client.AsyncClient)


def test_the_options_of_a_stream_are_those_of_predict():
    taken = inspect.signature(rollcast.client.Client.predict).parameters
    assert {*ForecastOptions.__annotations__} == {*taken} - {"self", "frames", "final_frame"}


@pytest.mark.parametrize("target", TARGETS, ids=lambda path: path.name)
def test_the_client_that_blocks_is_written_from_the_one_that_is_awaited(target):
    expected = sync_client(target)
    assert target.read_text() == expected, "run python -m tests.rollcast.write_sync_client"
