"""Bodies of the HTTP API: requests, responses and problem documents.

Positions are pixels of the frames that the user sent or asked for: x to the right, y down, (0, 0)
the top-left corner of the top-left pixel. Angular velocities are rad/s about the world's axes. Time
t = 0 is the last observed frame.
"""

import binascii
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar, cast

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    Strict,
    WithJsonSchema,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError, from_json

from rollcast.outputs import FORECAST_OUTPUTS, STEP_OUTPUTS, OutputSpec
from rollcast.scene import (
    MAX_BALLS,
    MAX_OBJECTS,
    MAX_SEED,
    BallColor,
    Color,
    Domain,
    Number,
    Scenario,
    Scene,
    SceneParameters,
)
from rollcast.trajectory import OBSERVED_FRAMES

API_VERSION = "1.0"
AUTO_MODEL = "auto"
REQUEST_ID_HEADER = "X-Request-ID"
REPLICA_HEADER = "X-Rollcast-Replica"
MAX_HORIZON = 1000
DEFAULT_HORIZON = 40
MIN_STEPS = OBSERVED_FRAMES
MAX_STEPS = 1000
MIN_RATE_HZ = 1e-3
MAX_RATE_HZ = 100_000
"""Rates of frames and steps, a second."""
MIN_FRAME_SIZE = 32
MAX_FRAME_SIZE = 4096
"""Sides of a frame that /predict reads, in pixels."""
MAX_IMAGE_SIZE = 1024
"""Largest side of a frame that /simulate draws, in pixels."""
NAMES_OF_A_SCENE = frozenset({"scenario", "seed", "textured"})
"""Fields of a request for a scene that a returned scene has, too."""


def _decode_base64(value: object) -> object:
    """Turn base64 text into bytes; multipart parts are bytes already."""
    if not isinstance(value, str):
        return value
    try:
        return binascii.a2b_base64(value, strict_mode=True)
    except ValueError as error:
        raise ValueError("base64 of a PNG, JPEG or WebP file, without line breaks") from error


def _decode_json(value: object) -> object:
    """Turn JSON text, as a multipart part has it, into values."""
    if not isinstance(value, str):
        return value
    try:
        return from_json(value)
    except ValueError as error:
        raise ValueError("JSON, as in a JSON body") from error


def _without_point(value: object) -> object:
    """Turn 20.0 into 20: clients whose numbers are all floats write whole numbers so."""
    return int(value) if type(value) is float and value.is_integer() else value


Integer = Annotated[int, Strict(), BeforeValidator(_without_point)]
Flag = Annotated[bool, Strict()]
ObjectCount = Annotated[Integer, Field(ge=1, le=MAX_OBJECTS)]
EncodedImage = Annotated[
    bytes,
    BeforeValidator(_decode_base64),
    WithJsonSchema({"type": "string", "contentEncoding": "base64"}),
]
Point = tuple[Number, Number]
Vector = tuple[Number, Number, Number]
Matrix = tuple[Point, Point]
Size = tuple[int, int]
Body = TypeVar("Body", bound="ResponseBody")


class RequestBody(BaseModel):
    """Body of a request. Unknown fields, NaN, infinities and numbers as text are rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def accepted_names(model: type[RequestBody]) -> frozenset[str]:
    """Return the names of all fields of a body, former ones included."""
    names: set[str] = set(model.model_fields)
    for field in model.model_fields.values():
        if isinstance(field.validation_alias, AliasChoices):
            names |= {str(choice) for choice in field.validation_alias.choices}
    return frozenset(names)


class ResponseBody(BaseModel):
    """Body of a response. A client ignores fields that a newer service has added."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def _value_type(shape: tuple[int, ...]) -> Any:  # noqa: ANN401
    """Return the type of nested lists of a fixed shape."""
    kind: Any = Number
    for length in reversed(shape):
        kind = tuple[(kind,) * length]
    return kind


def _path_type(shape: tuple[int, ...]) -> Any:  # noqa: ANN401
    return list[_value_type(shape)]


class _Numbered(ResponseBody):
    """One ball of an answer."""

    id: int
    """Index of the ball among the objects."""


def _outputs_body(
    name: str,
    base: type[Body],
    axes: str,
    fields: Mapping[str, OutputSpec],
    type_of: Callable[[tuple[int, ...]], Any],
) -> type[Body]:
    """Return a body with one field per output (``rollcast.outputs``)."""
    typed: dict[str, Any] = {
        field: (
            type_of(spec.shape) if spec.is_required else type_of(spec.shape) | None,
            Field(description=f"{axes}{spec.description}"),
        )
        for field, spec in fields.items()
    }
    return create_model(name, __base__=base, __module__=__name__, **typed)


_StepOutputs = _outputs_body(
    "_StepOutputs", _Numbered, "", {spec.step_name: spec for spec in STEP_OUTPUTS}, _value_type
)
_PathOutputs = _outputs_body(
    "_PathOutputs", _Numbered, "[horizon] ", {spec.name: spec for spec in STEP_OUTPUTS}, _path_type
)
_ForecastOutputs = _outputs_body(
    "_ForecastOutputs",
    ResponseBody,
    "[objects] ",
    {spec.name: spec for spec in FORECAST_OUTPUTS},
    _path_type,
)


class BallPrompt(RequestBody):
    """Point in the last observed frame that selects a ball."""

    x: Number
    """X coordinate in pixels of the last observed frame, to the right."""
    y: Number
    """Y coordinate in pixels of the last observed frame, down."""
    radius: Annotated[Number, Field(gt=0)] | None = None
    """Radius in pixels, at most the longer side of the frames; by default estimated."""


Horizon = Annotated[Integer, Field(ge=1, le=MAX_HORIZON)]
BallCount = Annotated[
    Annotated[Integer, Field(ge=1, le=MAX_BALLS)] | None,
    Field(validation_alias=AliasChoices("num_objects", "objects")),  # decision 0147
]
FrameRate = Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ)]


class PredictRequest(RequestBody):
    """Body of ``POST /predict``, as JSON or, with the images as file parts, as multipart."""

    model: str = AUTO_MODEL
    """Model: "auto", NAME (its default version) or NAME@VERSION."""
    frames: Annotated[
        list[EncodedImage], Field(min_length=OBSERVED_FRAMES, max_length=OBSERVED_FRAMES)
    ]
    """The four observed frames in order, t = -3..0: base64 of PNG, JPEG or WebP files of one size,
    32 to 4096 pixels a side; square, except for models for any number of balls. Transparent pixels
    are composed on white."""
    final_frame: EncodedImage | None = None
    """A frame of the same size that shows step ``final_step`` of the model."""
    horizon: Horizon | None = None
    """Number of steps, t = 0..horizon-1: 40 by default, with a final frame ``final_step`` + 1."""
    num_objects: BallCount = None
    """Number of balls: by default that of the named model, with "auto" one. A model for any number
    of balls follows the moving balls by default."""
    balls: Annotated[
        Annotated[list[BallPrompt], Field(min_length=1, max_length=MAX_BALLS)] | None,
        BeforeValidator(_decode_json),
    ] = None
    """Prompts that select balls, for a model for any number of balls: one per ball, in the order of
    the objects of the response."""
    scenario: Domain | None = None
    """Restriction of the choice to models for this scenario, or for footage of a set-up of your
    own."""
    frame_rate: FrameRate | None = None
    """Rate of the observed frames per second; default: the rate of the model's training data."""
    step_rate: FrameRate | None = None
    """Rate of the steps per second; default: ``frame_rate``. Steps between those of the model are
    interpolated."""


class SessionRequest(RequestBody):
    """First message of a session, ``WebSocket /stream``: text."""

    model: str = AUTO_MODEL
    """Model: "auto", NAME (its default version) or NAME@VERSION, without a final frame."""
    horizon: Horizon | None = None
    """Number of steps, t = 0..horizon-1: 40 by default."""
    num_objects: BallCount = None
    """Number of balls, as for ``POST /predict``."""
    scenario: Domain | None = None
    """Restriction of the choice to models for this scenario, or for footage of a set-up of your
    own."""
    frame_rate: FrameRate | None = None
    """Rate of the sent frames per second; default: the rate of the model's training data."""
    step_rate: FrameRate | None = None
    """Rate of the steps per second; default: ``frame_rate``."""


class ModelReference(ResponseBody):
    """Model that computed the forecast."""

    name: str
    version: int
    variant: str
    trained_horizon: int
    """Number of steps in training; later ones are extrapolated."""


class SeenBall(ResponseBody):
    """A ball in one observed frame, pixels of the frames that were sent."""

    x: float
    y: float
    radius: float


Motion = Literal["network", "kinematic"]
"""Method of a forecast: the network of the model, or a Kalman filter of constant velocity."""


class AlternativeForecast(ResponseBody):
    """Another forecast of the same ball."""

    motion: Motion
    positions: list[Point]
    """Positions [horizon][x, y], pixels."""
    covariances: list[Matrix]
    """Covariances [horizon][2][2], square pixels."""


class ForecastObject(_PathOutputs):
    """The forecast of one ball."""

    color: BallColor
    covariance_source: Literal["predicted", "empirical"]
    """Source: ``predicted`` by the network for these frames, or ``empirical``, the residuals of the
    model on validation data at that step."""
    score: Annotated[float, Field(ge=0, le=1)] | None = None
    """Confidence that the ball is there; None from models for a fixed number of balls."""
    seen: list[SeenBall] | None = None
    """The ball in each observed frame; None from models for a fixed number of balls."""
    warnings: list[str] = []  # noqa: RUF012 - of a pydantic model
    """Reasons to trust this ball's forecast less."""
    motion: Motion = "network"
    """Method: ``kinematic`` where "auto" estimates level ground; such a forecast has no angular
    velocities."""
    alternative: AlternativeForecast | None = None
    """The forecast of the other motion; None from models for a fixed number of balls."""


class DetectRequest(RequestBody):
    """Body of ``POST /detect``, as JSON or, with the images as file parts, as multipart."""

    model: str = AUTO_MODEL
    """Model for any number of balls: "auto", NAME (its default version) or NAME@VERSION."""
    frames: Annotated[
        list[EncodedImage], Field(min_length=OBSERVED_FRAMES, max_length=OBSERVED_FRAMES)
    ]
    """Four frames in order: base64 of PNG, JPEG or WebP files of one size, 32 to 4096 pixels a
    side."""
    min_score: Annotated[Number, Field(ge=0, le=1)] = 0.25
    """Minimum score of the coarse detector for a reported candidate."""
    refine_still: Flag = True
    """Refinement of balls that hardly move; without it the response takes less time."""


class DetectedBall(ResponseBody):
    """One ball in four frames."""

    score: Annotated[float, Field(ge=0, le=1)]
    """Confidence that the ball is present."""
    moving: Annotated[float, Field(ge=0, le=1)]
    """Confidence that it moves."""
    refined: bool
    """Refinement in patches; if false, the position is that of the coarse detector."""
    seen: list[SeenBall]
    """The ball in each frame, pixels."""
    visible: list[float]
    """Confidence that each frame shows the ball, 0 to 1."""


class DetectResponse(ResponseBody):
    """Answer of ``POST /detect``."""

    model: str
    """Model that detected the balls, NAME@VERSION."""
    frame_size: Size
    """Width and height of the frames, whose pixels are the unit of all positions."""
    balls: list[DetectedBall]
    """Balls by descending score."""


class PredictTiming(ResponseBody):
    """Time of each stage, in milliseconds."""

    decode: float
    encode: float
    rollout: float
    total: float
    """Time from the parsed request to the response, without the time in the queue."""


class ForecastSummary(_ForecastOutputs):
    """Fields of a forecast that belong to no step."""

    model: ModelReference
    frame_size: Size
    """Width and height of the sent frames, whose pixels are the unit of all positions."""
    frame_rate: float
    """Rate of the observed frames per second."""
    step_rate: float
    """Rate of the steps per second."""
    warnings: list[str]
    timing_ms: PredictTiming


class PredictResponse(ForecastSummary):
    """Answer of ``POST /predict``."""

    objects: list[ForecastObject]
    times_s: list[float]
    """Time of each step in seconds after the last observed frame."""
    ellipse50_radii: list[float]
    """Radius [horizon], in standard deviations of ``covariances``, of the ellipse that should
    contain the true position 50 % of the time: 1.18 for a Gaussian, less for errors with heavy
    tails. The ellipse for 95 % always has the radius of a Gaussian, 2.45."""


class StreamObject(_StepOutputs):
    """One ball at one step."""


class StreamStep(ResponseBody):
    """Event ``step`` of ``POST /predict/stream``, one for every step."""

    step: int
    time_s: float
    """Time in seconds after the last observed frame."""
    ellipse50_radius: float
    """Radius at this step, as in ``PredictResponse.ellipse50_radii``."""
    objects: list[StreamObject]


class StreamBall(ResponseBody):
    """Fields of one ball that are the same at every step."""

    id: int
    color: BallColor
    covariance_source: Literal["predicted", "empirical"]
    score: Annotated[float, Field(ge=0, le=1)] | None = None
    seen: list[SeenBall] | None = None
    warnings: list[str] = []
    motion: Motion = "network"


class StreamDone(ForecastSummary):
    """Event ``done`` of ``POST /predict/stream``, the last one."""

    objects: list[StreamBall]


class SimulateRequest(RequestBody):
    """Body of ``POST /simulate``.

    ``scene`` holds the parameters that are not sampled. A returned scene can be posted back: its
    ``scenario``, ``seed`` and ``textured`` are those of the request, which may repeat them.
    """

    scenario: Scenario
    seed: Annotated[Integer, Field(ge=0, le=MAX_SEED)]
    """Seed of the scene: the same seed gives the same bytes."""
    num_objects: ObjectCount | None = None
    """Number of balls: by default that of ``scene.positions_m``, else one."""
    steps: Annotated[Integer, Field(ge=MIN_STEPS, le=MAX_STEPS)] = OBSERVED_FRAMES + DEFAULT_HORIZON
    start_step: Annotated[Integer, Field(ge=0, le=MAX_STEPS)] | None = None
    """First step of the answer, counted from the start of the simulation; by default the calibrated
    test start."""
    image_size: Annotated[Integer, Field(ge=MIN_FRAME_SIZE, le=MAX_IMAGE_SIZE)] = 128
    """Side of the frames in pixels."""
    textured: Flag | None = None
    """Texture on the ball; default: true for one ball, false for several."""
    include_frames: Flag = True
    include_surface: Flag = False
    scene: SceneParameters = SceneParameters()
    """Parameters of the scene that are not sampled."""

    @property
    def balls(self) -> int:
        """Requested number of balls."""
        return self.num_objects or len(self.parameters.get("positions_m", (None,)))

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters that are not sampled, by name, without scenario and seed."""
        given = self.scene.given()
        if self.textured is not None:
            given["textured"] = self.textured
        return {name: value for name, value in given.items() if name not in ("scenario", "seed")}

    @model_validator(mode="before")
    @classmethod
    def _one_place_for_each_parameter(cls, data: object) -> object:
        if not isinstance(data, dict):
            return data
        body = dict(cast("dict[str, Any]", data))
        for name in sorted(body.keys() & SceneParameters.model_fields.keys() - NAMES_OF_A_SCENE):
            raise PydanticCustomError(
                "misplaced",
                "{field} is a parameter of the scene",
                {"field": name, "value": body[name], "expected": f"scene.{name} instead"},
            )
        scene = body.get("scene")
        if scene is None:
            body.pop("scene", None)
        if not isinstance(scene, dict):
            return body
        for name in NAMES_OF_A_SCENE & scene.keys():
            own, value = body.get(name), cast("dict[str, Any]", scene)[name]
            if own is None:
                body[name] = value
            elif value is not None and own != value:
                raise PydanticCustomError(
                    "given_twice",
                    "{field} and scene.{field} differ",
                    {"field": name, "value": own, "expected": f"the same as scene.{name}"},
                )
        return body

    @model_validator(mode="after")
    def _balls_agree(self) -> "SimulateRequest":
        if self.textured and self.balls > 1:
            raise PydanticCustomError(
                "textured_balls",
                "several balls are told by their colour",
                {"field": "textured", "value": True, "expected": "false with several balls"},
            )
        positions = self.parameters.get("positions_m")
        if positions is not None and len(positions) != self.balls:
            raise PydanticCustomError(
                "balls_differ",
                "num_objects and scene.positions_m differ",
                {
                    "field": "num_objects",
                    "value": self.num_objects,
                    "expected": f"{len(positions)}, the number of scene.positions_m",
                },
            )
        return self


class SimulatedObject(ResponseBody):
    """The true path of one ball."""

    id: int
    color: Color
    radius_px: float
    positions: list[Point]
    """Positions [steps][x, y], pixels."""
    angular_velocities: list[Vector]
    """Angular velocities [steps][x, y, z], rad/s."""


class SurfaceGrid(ResponseBody):
    """Heights of the ground at points that span the frame from edge to edge."""

    half_width_m: float
    """Half the side of the square that the frame shows, metres."""
    heights_m: list[list[float | None]]
    """Heights [n][n] in metres, to the nearest micrometre: rows from top to bottom of the frame,
    columns from left to right, the outermost points on its edges. None outside the surface."""


class SimulateResponse(ResponseBody):
    """Answer of ``POST /simulate``.

    Frames 0..3 can be posted to /predict unchanged; forecast step t then belongs to index t + 3.
    """

    scenario: Scenario
    seed: int
    frame_rate: float
    frame_size: Size
    start_step: int
    """Step of the simulation that index 0 shows."""
    times_s: list[float]
    """Time in seconds after index 0."""
    frames: list[str] | None
    """Frames [steps], base64 of PNG; None without ``include_frames``."""
    objects: list[SimulatedObject]
    surface: SurfaceGrid | None = None
    """Heights of the ground; None without ``include_surface``."""
    scene: Scene


class ModelMetrics(ResponseBody):
    """Accuracy of a model, in pixels of 128 x 128 frames."""

    validation_error_px: float
    """Validation error, which "auto" compares between models."""
    rows: list[dict[str, JsonValue]]
    """One row per split, scenario and horizon (``rollcast.manifest.MetricRow``)."""


class ModelSetup(ResponseBody):
    """The set-up whose footage a model was trained on."""

    colors: list[BallColor]
    """Color of each ball, in the order of the objects of a forecast."""
    crop: tuple[int, int, int]
    """Square of the camera's pictures that frames show: x, y and side in pixels."""


class ModelEntry(ResponseBody):
    """One version of one model. Fields of its manifest are None if the manifest is not readable."""

    name: str
    version: int
    default: bool = False
    """Selection of this version by a name without version."""
    status: Literal["ready", "invalid", "unloaded"]
    reason: str | None = None
    """Reason for a status other than ``ready``."""
    variant: str | None = None
    preset: str | None = None
    scenarios: list[Domain] | None = None
    objects: int | None = None
    max_objects: int | None = None
    """Maximum number of balls of a model for any number of balls, which accepts prompts and frames
    of any aspect ratio; None if ``objects`` is fixed."""
    frame_rate_hz: float | None = None
    """Rate of the steps in Hz, and of the training frames unless ``frame_rates_hz`` is given."""
    frame_rates_hz: tuple[float, float] | None = None
    """Lowest and highest supported ``frame_rate``; None where ``frame_rate_hz`` is assumed."""
    setup: ModelSetup | None = None
    """Camera set-up of the training footage; None for models for simulated scenes."""
    frames: int | None = None
    """Number of frames: 4, or 5 with a final frame."""
    final_step: int | None = None
    trained_horizon: int | None = None
    covariance_source: Literal["predicted", "empirical"] | None = None
    angular_velocity: bool | None = None
    metrics: ModelMetrics | None = None


class ModelList(ResponseBody):
    """Answer of ``GET /models``."""

    models: list[ModelEntry]


class ModelDetail(ModelEntry):
    """Answer of ``GET /models/{name}`` (its default version) and of one version."""

    versions: list[int]
    """Versions of the model."""
    licence: str | None
    card: str | None
    """Model card in Markdown."""


class Health(ResponseBody):
    """Answer of ``GET /health/live`` and ``GET /health/ready``."""

    status: Literal["live", "ready", "loading", "no usable model", "draining"]


class FieldError(ResponseBody):
    """Invalid value in a request."""

    field: str | None = None
    """Path of the field: ``frames[2]``, ``scene.radius_m``."""
    value: JsonValue = None
    """Value in the request, shortened."""
    expected: str | None = None
    """Description of valid values."""


class Problem(ResponseBody):
    """A problem document (RFC 9457), ``application/problem+json``."""

    type: str
    """Stable name of the kind of problem: ``/problems/unknown-model``."""
    title: str
    status: int
    detail: str
    field: str | None = None
    value: JsonValue = None
    expected: str | None = None
    """First invalid value, as in ``FieldError``; absent if the problem concerns no single value."""
    errors: list[FieldError] | None = None
    """List of all invalid values, if there are several."""


TickStatus = Literal["open", "collecting", "forecast", "superseded", "refused"]
"""Outcome of one message of a session.

``open``: the first message, the session's options, is accepted. ``collecting``: there are fewer
than four frames. ``forecast``: the forecast from this frame and the three before it.
``superseded``: a newer frame arrived before the forecast from this one began; the frame belongs
to later forecasts. ``refused``: ``problem`` gives the reason."""


class TickResponse(ResponseBody):
    """Answer to one message of a session, ``WebSocket /stream``."""

    tick: int
    """Number of the frame, from 1; 0 answers the first message."""
    status: TickStatus
    latency_ms: float
    """Time from the receipt of the message to this answer."""
    forecast: PredictResponse | None = None
    """Forecast as of ``POST /predict``, with the status ``forecast``."""
    problem: Problem | None = None
    """Problem document, with the status ``refused``."""
