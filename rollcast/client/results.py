"""Results of the calls: NumPy arrays with units.

Pixels refer to the frames that were sent or requested; x to the right, y down, (0, 0) the
top-left corner of the top-left pixel. Angular velocities are rad/s about the world's axes.
"""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, Self

import numpy as np
from jaxtyping import Bool, Float64
from PIL import Image

from rollcast.client import files, pictures, tables
from rollcast.client.images import Crop, Frames, decoded
from rollcast.client.shapes import checked, checked_times, require
from rollcast.outputs import OUTPUTS, STEP_OUTPUTS, OutputName, OutputSpec
from rollcast.scene import Color, Scene
from rollcast.schemas import (
    MAX_IMAGE_SIZE,
    AlternativeForecast,
    DetectResponse,
    ForecastObject,
    ModelReference,
    Motion,
    PredictResponse,
    PredictTiming,
    SimulateResponse,
    StreamDone,
    StreamStep,
    SurfaceGrid,
)
from rollcast.trajectory import OBSERVED_FRAMES

if TYPE_CHECKING:
    from pandas import DataFrame
    from typing_extensions import TypeVar

    FramesT = TypeVar("FramesT", bound=np.ndarray | None, default=np.ndarray | None, covariant=True)
    SurfaceT = TypeVar("SurfaceT", bound="Surface | None", default="Surface | None", covariant=True)
else:
    from typing import TypeVar  # which knows defaults from Python 3.13 on

    FramesT = TypeVar("FramesT")
    SurfaceT = TypeVar("SurfaceT")


@dataclass(frozen=True)
class Detections:
    """Balls in four frames, by descending score."""

    seen: Float64[np.ndarray, "balls 4 3"]
    """Positions x and y, and radius, of each ball in each frame, pixels."""
    scores: Float64[np.ndarray, " balls"]
    """Confidence, 0 to 1, that each ball is there."""
    moving: Float64[np.ndarray, " balls"]
    """Confidence, 0 to 1, that each ball moves."""
    visible: Float64[np.ndarray, "balls 4"]
    """Confidence, 0 to 1, that each frame shows the ball."""
    refined: Bool[np.ndarray, " balls"]
    """Refinement in patches; if false, the position is that of the coarse detector."""
    frame_size: tuple[int, int]
    """Width and height of the frames, pixels."""
    model: str
    """NAME@VERSION of the model that answered."""

    @classmethod
    def from_response(cls, response: DetectResponse) -> Self:
        """Turn the response's lists into arrays.

        Raises
        ------
        ValueError
            When they do not fit together.
        """
        balls = response.balls
        count = len(balls)
        seen = [[(at.x, at.y, at.radius) for at in ball.seen] for ball in balls]
        shape = (count, OBSERVED_FRAMES)
        return cls(
            seen=checked("seen", seen or np.empty((0, OBSERVED_FRAMES, 3)), (*shape, 3)),
            scores=checked("scores", [ball.score for ball in balls], (count,)),
            moving=checked("moving", [ball.moving for ball in balls], (count,)),
            visible=checked(
                "visible", [ball.visible for ball in balls] or np.empty((0, OBSERVED_FRAMES)), shape
            ),
            refined=np.array([ball.refined for ball in balls], bool),
            frame_size=response.frame_size,
            model=response.model,
        )


@dataclass(frozen=True)
class ForecastStep:
    """One step of a forecast, as soon as it is computed."""

    step: int
    """Number of the step; 0 is the last observed frame."""
    time_s: float
    """Seconds after the last observed frame."""
    ellipse50_radius: float
    """Element of ``Forecast.ellipse50_radii`` for this step."""
    outputs: Mapping[OutputName, np.ndarray]
    """Outputs [objects, ...] of the model by name."""

    @property
    def positions(self) -> Float64[np.ndarray, "objects 2"]:
        """Pixels."""
        return self.outputs["positions"]

    @property
    def covariances(self) -> Float64[np.ndarray, "objects 2 2"]:
        """Square pixels."""
        return self.outputs["covariances"]

    @property
    def angular_velocities(self) -> Float64[np.ndarray, "objects 3"] | None:
        """rad/s; NaN for objects with kinematic motion; None if no object has any."""
        return self.outputs.get("angular_velocities")

    @classmethod
    def from_event(cls, event: StreamStep) -> Self:
        """Turn the event's lists into arrays.

        Raises
        ------
        ValueError
            When they do not fit together.
        """
        balls = event.objects
        require(len(balls) > 0, "the step has no objects")
        return cls(
            step=event.step,
            time_s=event.time_s,
            ellipse50_radius=event.ellipse50_radius,
            outputs=_outputs(
                (spec, [getattr(ball, spec.step_name) for ball in balls], (len(balls),))
                for spec in STEP_OUTPUTS
            ),
        )


@dataclass(frozen=True)
class Forecast:
    """Forecast paths of the balls, steps t = 0 (the last observed frame) to T-1."""

    outputs: Mapping[OutputName, np.ndarray]
    """Outputs of the model by name: [objects, T, ...], or [objects, ...] for outputs without a time
    axis. ``positions`` and others are attributes as well."""
    covariance_source: Literal["predicted", "empirical"]
    """Source: ``predicted`` for these frames, or ``empirical``, residuals on validation data."""
    ellipse50_radii: Float64[np.ndarray, " T"]
    """Radius, in standard deviations, of the ellipse that should contain the true position 50 % of
    the time. The radius for 95 % is always 2.45."""
    times_s: Float64[np.ndarray, " T"]
    """Seconds after the last observed frame."""
    colors: tuple[str, ...]
    """Color of each object."""
    scores: Float64[np.ndarray, " objects"] | None
    """Confidence, 0 to 1, that each ball is there; None from models for a fixed number of balls."""
    seen: Float64[np.ndarray, "objects 4 3"] | None
    """Positions x and y, and radius, of each ball in the four observed frames, pixels; None from
    models for a fixed number of balls."""
    object_warnings: tuple[tuple[str, ...], ...]
    """Reasons to trust the forecast of each object less."""
    motions: tuple[Motion, ...]
    """Method of the forecast of each object: ``network`` or ``kinematic``."""
    alternatives: tuple[AlternativeForecast | None, ...]
    """Forecast of each object by the other motion; None from models for a fixed number of balls."""
    model: ModelReference
    """The model that answered."""
    frame_size: tuple[int, int]
    """Width and height of the frames, pixels."""
    frame_rate: float
    """Frames a second."""
    step_rate: float
    """Steps a second."""
    warnings: tuple[str, ...]
    """Reasons to trust the forecast less."""
    timing_ms: PredictTiming
    """Time of each stage on the service."""

    @property
    def positions(self) -> Float64[np.ndarray, "objects T 2"]:
        """Pixels."""
        return self.outputs["positions"]

    @property
    def covariances(self) -> Float64[np.ndarray, "objects T 2 2"]:
        """Square pixels."""
        return self.outputs["covariances"]

    @property
    def angular_velocities(self) -> Float64[np.ndarray, "objects T 3"] | None:
        """rad/s; NaN for objects with kinematic motion; None if no object has any."""
        return self.outputs.get("angular_velocities")

    @property
    def final_positions(self) -> Float64[np.ndarray, "objects 2"] | None:
        """Pixels: positions of the balls in the final frame; None without one."""
        return self.outputs.get("final_positions")

    def to_dataframe(self) -> "DataFrame":
        """Return a row for every step of every ball, in the order of time (needs pandas).

        Columns: ``step``, ``time_s``, ``object``, ``color``, ``x_px``, ``y_px``, the covariance's
        ``xx_px2``, ``xy_px2`` and ``yy_px2``, and where the model has them the angular velocities
        ``wx_rad_s``, ``wy_rad_s`` and ``wz_rad_s`` and other outputs. Of models for any number of
        balls also ``radius_px``, ``score`` and ``warnings``, which are the same at every step of a
        ball.

        Raises
        ------
        rollcast.errors.MissingExtraError
            When pandas is not installed.
        """
        return tables.dataframe(tables.forecast_columns(self))

    def to_json(self) -> str:
        """Return the document that ``POST /predict`` answers with."""
        return files.forecast_json(self)

    def save(
        self,
        path: Path | str,
        frames: Frames | None = None,
        *,
        times_s: Sequence[float] | None = None,
        crop: Crop | None = None,
    ) -> None:
        """Write the forecast into a file of the kind that the suffix names.

        Parameters
        ----------
        path
            ``.png``, ``.jpg`` and ``.webp`` are drawn as by ``plot``; ``.mp4``, ``.webm`` and
            ``.gif`` are a video with a frame for every step; ``.json`` is ``to_json``, and ``.csv``
            has the rows of ``to_dataframe``.
        frames, times_s, crop
            The background of pictures and videos, as for ``plot``.

        Raises
        ------
        ValueError
            When the suffix is another one, or frames do not fit.
        rollcast.errors.MissingExtraError
            When a video needs PyAV, which is not installed (``.gif`` does not).
        OSError
            When the file cannot be written.
        """
        files.save(self, Path(path), frames, times_s, crop)

    def plot(
        self,
        frames: Frames | None = None,
        *,
        times_s: Sequence[float] | None = None,
        crop: Crop | None = None,
        panels: int = 6,
    ) -> Image.Image:
        """Draw the forecast over the last observed frame and, where there are any, later ones.

        Parameters
        ----------
        frames
            The last observed frame and later frames, of the size of the sent frames; for a
            simulation ``frames[3:]``. By default a dark background.
        times_s
            Seconds after the last observed frame, of every frame; by default they follow each
            other as the forecast's steps do. Frames after its end are left out.
        crop
            As for ``Client.predict``.
        panels
            Largest number of later frames that are shown.

        Returns
        -------
        PIL.Image.Image
            RGB; the whole path with crosses and two-sigma ellipses, and the later frames beside it.

        Raises
        ------
        ValueError
            When a frame's size is not ``frame_size`` or ``times_s`` does not fit.
        """
        return pictures.forecast(self, frames, times_s, crop, panels)

    def _repr_png_(self) -> bytes:
        """Return a picture for notebooks."""
        return files.png(self)

    @classmethod
    def from_response(cls, response: PredictResponse) -> Self:
        """Turn the answer's lists into arrays.

        Raises
        ------
        ValueError
            When they do not fit together.
        """
        balls = response.objects
        require(len(balls) > 0, "there are no objects")
        require([ball.id for ball in balls] == [*range(len(balls))], "the objects are not numbered")
        times_s = checked_times("times_s", response.times_s)
        shape = (len(balls), len(times_s))
        require(len(times_s) > 0, "there are no steps")
        require(min(response.frame_size) > 0, f"frame_size is {response.frame_size}")
        for name, rate in (("frame_rate", response.frame_rate), ("step_rate", response.step_rate)):
            require(rate > 0, f"{name} is {rate}")
        source = balls[0].covariance_source
        require(
            all(ball.covariance_source == source for ball in balls), "covariance_source differs"
        )
        return cls(
            outputs=_outputs(
                (spec, [getattr(ball, spec.name) for ball in balls], shape)
                if spec.is_per_step
                else (spec, getattr(response, spec.name), shape[:1])
                for spec in OUTPUTS
            ),
            covariance_source=source,
            ellipse50_radii=checked("ellipse50_radii", response.ellipse50_radii, shape[1:]),
            times_s=times_s,
            colors=tuple(ball.color for ball in balls),
            scores=_unless_unknown("scores", [ball.score for ball in balls], (len(balls),)),
            seen=_unless_unknown(
                "seen", [_seen(ball) for ball in balls], (len(balls), OBSERVED_FRAMES, 3)
            ),
            object_warnings=tuple(tuple(ball.warnings) for ball in balls),
            motions=tuple(ball.motion for ball in balls),
            alternatives=tuple(ball.alternative for ball in balls),
            model=response.model,
            frame_size=response.frame_size,
            frame_rate=response.frame_rate,
            step_rate=response.step_rate,
            warnings=tuple(response.warnings),
            timing_ms=response.timing_ms,
        )

    @classmethod
    def from_events(cls, steps: Sequence[StreamStep], done: StreamDone) -> Self:
        """Put a stream's events together.

        Raises
        ------
        ValueError
            When they do not fit together.
        """
        ids = [ball.id for ball in done.objects]
        for step in steps:
            require([ball.id for ball in step.objects] == ids, f"step {step.step}: other objects")
        balls = [
            ForecastObject(
                **dict(ball),
                **{spec.name: _path(steps, index, spec.step_name) for spec in STEP_OUTPUTS},
            )
            for index, ball in enumerate(done.objects)
        ]
        whole: dict[str, Any] = dict(done)
        whole |= {
            "objects": balls,
            "times_s": [step.time_s for step in steps],
            "ellipse50_radii": [step.ellipse50_radius for step in steps],
        }
        return cls.from_response(PredictResponse(**whole))


@dataclass(frozen=True)
class Surface:
    """The ground of a scene: its heights at points that span the frame from edge to edge."""

    heights_m: Float64[np.ndarray, "n n"]
    """Metres; rows from the frame's top to its bottom, columns from left to right, the outermost on
    its edges. NaN where there is no ground."""
    half_width_m: float
    """Half the side of the square that the frame shows, metres."""


@dataclass(frozen=True)
class Simulation(Generic[FramesT, SurfaceT]):
    """A scene and the motion in it. Forecast step t of frames 0..3 belongs to index t + 3.

    To type checkers ``Simulation[FramesT, SurfaceT]`` says whether frames and surface are present;
    ``simulate`` returns the right one for its arguments, and a bare ``Simulation`` is any.
    """

    frames: FramesT
    """RGB, uint8 [steps, S, S, 3]; None if they were not requested."""
    positions: Float64[np.ndarray, "objects steps 2"]
    """Pixels."""
    angular_velocities: Float64[np.ndarray, "objects steps 3"]
    """Angular velocities in rad/s."""
    times_s: Float64[np.ndarray, " steps"]
    """Seconds after index 0."""
    radii_px: Float64[np.ndarray, " objects"]
    """Pixels."""
    colors: tuple[Color, ...]
    """Color of each object."""
    scene: Scene
    """Every parameter; ``simulate`` takes it back."""
    start_step: int
    """Step of the simulation that index 0 shows."""
    frame_size: tuple[int, int]
    """Width and height of the frames, pixels."""
    frame_rate: float
    """Frames a second."""
    surface: SurfaceT
    """The ground; None if it was not requested."""

    def to_dataframe(self) -> "DataFrame":
        """Return a row for every step of every ball, in the order of time (needs pandas).

        Columns: ``step``, ``time_s``, ``object``, ``color``, ``x_px``, ``y_px`` and the angular
        velocities ``wx_rad_s``, ``wy_rad_s`` and ``wz_rad_s``.

        Raises
        ------
        rollcast.errors.MissingExtraError
            When pandas is not installed.
        """
        return tables.dataframe(tables.simulation_columns(self))

    def plot(self, *, panels: int = 6) -> Image.Image:
        """Draw the true path over the first frame, and later frames beside it.

        Parameters
        ----------
        panels
            Largest number of later frames that are shown.

        Raises
        ------
        ValueError
            When the simulation has no frames.
        """
        return pictures.simulation(self, panels)

    @staticmethod
    def from_response(response: SimulateResponse) -> "Simulation":
        """Turn the answer's lists and images into arrays.

        Raises
        ------
        ValueError
            When they do not fit together, or an image cannot be decoded.
        """
        balls, ground = response.objects, response.surface
        require(len(balls) > 0, "there are no objects")
        times_s = checked_times("times_s", response.times_s)
        require(response.frame_rate > 0, f"frame_rate is {response.frame_rate}")
        shape = (len(balls), len(times_s))
        return Simulation(
            frames=None if response.frames is None else _decoded_frames(response),
            positions=checked("positions", [ball.positions for ball in balls], (*shape, 2)),
            angular_velocities=checked(
                "angular_velocities", [ball.angular_velocities for ball in balls], (*shape, 3)
            ),
            times_s=times_s,
            radii_px=np.array([ball.radius_px for ball in balls]),
            colors=tuple(ball.color for ball in balls),
            scene=response.scene,
            start_step=response.start_step,
            frame_size=response.frame_size,
            frame_rate=response.frame_rate,
            surface=None if ground is None else _surface(ground),
        )


def _decoded_frames(response: SimulateResponse) -> np.ndarray:
    """Decode the frames one by one, each of the size that the answer states."""
    encoded = response.frames or []
    steps, (width, height) = len(response.times_s), response.frame_size
    require(len(encoded) == steps, f"there are {len(encoded)} frames of {steps} steps")
    require(0 < width <= MAX_IMAGE_SIZE and 0 < height <= MAX_IMAGE_SIZE, "frame_size is wrong")
    frames = np.empty((steps, height, width, 3), np.uint8)
    for index, text in enumerate(encoded):
        frame = decoded(base64.b64decode(text, validate=True))
        require(frame.shape == frames.shape[1:], f"frame {index} is not of the size frame_size")
        frames[index] = frame
    return frames


def _surface(grid: SurfaceGrid) -> Surface:
    points = len(grid.heights_m)
    return Surface(checked("heights_m", grid.heights_m, (points, points)), grid.half_width_m)


def _outputs(
    given: Iterable[tuple[OutputSpec, Sequence[Any] | None, tuple[int, ...]]],
) -> dict[OutputName, np.ndarray]:
    """Return outputs as arrays of their shape behind another one, without missing ones."""
    outputs: dict[OutputName, np.ndarray] = {}
    for spec, values, axes in given:
        if values is None or all(value is None for value in values):
            continue
        # Objects with kinematic motion have no values of some outputs.
        unknown = np.full((*axes[1:], *spec.shape), np.nan).tolist()
        known = [unknown if value is None else value for value in values]
        outputs[spec.name] = checked(spec.name, known, (*axes, *spec.shape))
    variances = np.diagonal(outputs["covariances"], axis1=-2, axis2=-1)
    require(bool((variances >= 0).all()), "a variance is negative")
    return outputs


def _path(steps: Sequence[StreamStep], index: int, name: str) -> Any:  # noqa: ANN401
    """Return an output of one object at all steps; None if it is missing at one."""
    values = [getattr(step.objects[index], name) for step in steps]
    return None if any(value is None for value in values) else values


def _seen(ball: ForecastObject) -> list[tuple[float, float, float]] | None:
    return None if ball.seen is None else [(place.x, place.y, place.radius) for place in ball.seen]


def _unless_unknown(
    name: str, values: Sequence[object], shape: tuple[int, ...]
) -> np.ndarray | None:
    known = [value is not None for value in values]
    require(all(known) or not any(known), f"{name} of some objects are missing")
    return checked(name, values, shape) if any(known) else None
