"""What the calls return: numpy arrays, with their units.

Pixels are those of the frames that were sent or asked for; x to the right, y down, (0, 0) the
top-left corner of the top-left pixel. Angular velocities are rad/s about the world's axes.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image

from rollcast.client import pictures, tables
from rollcast.client.images import Crop, Frames, decoded
from rollcast.scene import Color, Scene
from rollcast.schemas import (
    ForecastObject,
    ModelReference,
    PredictResponse,
    PredictTiming,
    SimulateResponse,
    StreamDone,
    StreamStep,
)

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class ForecastStep:
    """One step of a forecast, as soon as it is computed."""

    step: int
    """0 is the last observed frame."""
    time_s: float
    """Seconds after the last observed frame."""
    half_radius: float
    """Of this step, as in ``Forecast.half_radii``."""
    positions: Float64[np.ndarray, "objects 2"]
    """Pixels."""
    covariances: Float64[np.ndarray, "objects 2 2"]
    """Square pixels."""
    angular_velocities: Float64[np.ndarray, "objects 3"] | None
    """rad/s; None when the model has none."""

    @classmethod
    def from_event(cls, event: StreamStep) -> Self:
        """Turn the event's lists into arrays."""
        return cls(
            step=event.step,
            time_s=event.time_s,
            half_radius=event.half_radius,
            positions=np.array([ball.position for ball in event.objects]),
            covariances=np.array([ball.covariance for ball in event.objects]),
            angular_velocities=_unless_unknown([ball.angular_velocity for ball in event.objects]),
        )


@dataclass(frozen=True)
class Forecast:
    """Where the balls go, steps t = 0 (the last observed frame) to T-1."""

    positions: Float64[np.ndarray, "objects T 2"]
    """Pixels."""
    covariances: Float64[np.ndarray, "objects T 2 2"]
    """Square pixels."""
    covariance_source: Literal["predicted", "empirical"]
    """``predicted`` for these frames, or ``empirical``: residuals on validation data."""
    half_radii: Float64[np.ndarray, " T"]
    """Standard deviations: radius of the ellipse that should hold the truth every second time. That
    of the ellipse that should hold 95 % is always 2.45."""
    angular_velocities: Float64[np.ndarray, "objects T 3"] | None
    """rad/s; None when the model has none."""
    final_positions: Float64[np.ndarray, "objects 2"] | None
    """Pixels: where the final frame was seen to show the balls; None without one."""
    times_s: Float64[np.ndarray, " T"]
    """Seconds after the last observed frame."""
    colors: tuple[str, ...]
    """Of each object."""
    model: ModelReference
    """The model that answered."""
    frame_size: tuple[int, int]
    """Width and height of the frames, pixels."""
    frame_rate: float
    """Frames a second."""
    warnings: tuple[str, ...]
    """Reasons to trust the forecast less."""
    timing_ms: PredictTiming
    """Where the service spent its time."""

    def to_dataframe(self) -> "DataFrame":
        """Return a row for every step of every ball, in the order of time (needs pandas).

        Columns: ``step``, ``time_s``, ``object``, ``color``, ``x_px``, ``y_px``, the covariance's
        ``xx_px2``, ``xy_px2`` and ``yy_px2``, and where the model has them the angular velocities
        ``wx_rad_s``, ``wy_rad_s`` and ``wz_rad_s``.

        Raises
        ------
        rollcast.errors.MissingExtraError
            When pandas is not installed.
        """
        return tables.dataframe(tables.forecast_columns(self))

    def plot(
        self,
        frames: Frames,
        *,
        times_s: Sequence[float] | None = None,
        crop: Crop | None = None,
        panels: int = 6,
    ) -> Image.Image:
        """Draw the forecast over the last observed frame and, where there are any, later ones.

        Parameters
        ----------
        frames
            The last observed frame, then any that follow it, as large as those that were sent. Of a
            simulation: ``frames[3:]``.
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

    @classmethod
    def from_response(cls, response: PredictResponse) -> Self:
        """Turn the answer's lists into arrays."""
        final = response.final_positions
        return cls(
            positions=np.array([ball.positions for ball in response.objects]),
            covariances=np.array([ball.covariances for ball in response.objects]),
            covariance_source=response.objects[0].covariance_source,
            half_radii=np.array(response.half_radii),
            angular_velocities=_unless_unknown(
                [ball.angular_velocities for ball in response.objects]
            ),
            final_positions=None if final is None else np.array(final),
            times_s=np.array(response.times_s),
            colors=tuple(ball.color for ball in response.objects),
            model=response.model,
            frame_size=response.frame_size,
            frame_rate=response.frame_rate,
            warnings=tuple(response.warnings),
            timing_ms=response.timing_ms,
        )

    @classmethod
    def from_events(cls, steps: Sequence[StreamStep], done: StreamDone) -> Self:
        """Put a stream's events together."""
        balls = [
            ForecastObject(
                **dict(ball),
                positions=[step.objects[index].position for step in steps],
                covariances=[step.objects[index].covariance for step in steps],
                angular_velocities=None
                if any(step.objects[index].angular_velocity is None for step in steps)
                else [step.objects[index].angular_velocity or (0, 0, 0) for step in steps],
            )
            for index, ball in enumerate(done.objects)
        ]
        whole: dict[str, Any] = dict(done)
        whole |= {
            "objects": balls,
            "times_s": [step.time_s for step in steps],
            "half_radii": [step.half_radius for step in steps],
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
class Simulation:
    """A scene and what happens in it. Forecast step t of frames 0..3 belongs to index t + 3."""

    frames: UInt8[np.ndarray, "steps S S 3"] | None
    """RGB; None when they were not asked for."""
    positions: Float64[np.ndarray, "objects steps 2"]
    """Pixels."""
    angular_velocities: Float64[np.ndarray, "objects steps 3"]
    """rad/s."""
    times_s: Float64[np.ndarray, " steps"]
    """Seconds after index 0."""
    radii_px: Float64[np.ndarray, " objects"]
    """Pixels."""
    colors: tuple[Color, ...]
    """Of each object."""
    scene: Scene
    """Every parameter; ``simulate`` takes it back."""
    start_step: int
    """Step of the simulation that index 0 shows."""
    frame_size: tuple[int, int]
    """Width and height of the frames, pixels."""
    frame_rate: float
    """Frames a second."""
    surface: Surface | None = None
    """The ground; None when it was not asked for."""

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

    @classmethod
    def from_response(cls, response: SimulateResponse) -> Self:
        """Turn the answer's lists and images into arrays."""
        files, ground = response.frames, response.surface
        return cls(
            frames=None
            if files is None
            else np.stack([decoded(base64.b64decode(file)) for file in files]),
            positions=np.array([ball.positions for ball in response.objects]),
            angular_velocities=np.array([ball.angular_velocities for ball in response.objects]),
            times_s=np.array(response.times_s),
            radii_px=np.array([ball.radius_px for ball in response.objects]),
            colors=tuple(ball.color for ball in response.objects),
            scene=response.scene,
            start_step=response.start_step,
            frame_size=response.frame_size,
            frame_rate=response.frame_rate,
            surface=None
            if ground is None
            else Surface(np.array(ground.heights_m, np.float64), ground.half_width_m),
        )


def _unless_unknown(values: Sequence[object]) -> np.ndarray | None:
    return None if None in values else np.array(values)
