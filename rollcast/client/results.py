"""What the calls return: numpy arrays, with their units.

Pixels are those of the frames that were sent or asked for; x to the right, y down, (0, 0) the
top-left corner of the top-left pixel. Angular velocities are rad/s about the world's axes.
"""

import base64
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, UInt8

from rollcast.client.images import decoded
from rollcast.http import ModelReference, PredictResponse, PredictTiming, SimulateResponse
from rollcast.scene import Color, Scene


@dataclass(frozen=True)
class Forecast:
    """Where the balls go, steps t = 0 (the last observed frame) to T-1."""

    positions: Float64[np.ndarray, "objects T 2"]
    """Pixels."""
    covariances: Float64[np.ndarray, "objects T 2 2"]
    """Square pixels."""
    covariance_source: Literal["predicted", "empirical"]
    """``predicted`` for these frames, or ``empirical``: residuals on validation data."""
    angular_velocities: Float64[np.ndarray, "objects T 3"] | None
    """rad/s; None when the model has none."""
    final_positions: Float64[np.ndarray, "objects 2"] | None
    """Pixels: where the final frame was seen to show the balls; None without one."""
    times_s: Float64[np.ndarray, " T"]
    """Seconds after the last observed frame."""
    colors: tuple[Color, ...]
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

    @classmethod
    def from_response(cls, response: PredictResponse) -> "Forecast":
        """Turn the answer's lists into arrays."""
        turning = [ball.angular_velocities for ball in response.objects]
        final = response.final_positions
        return cls(
            positions=np.array([ball.positions for ball in response.objects]),
            covariances=np.array([ball.covariances for ball in response.objects]),
            covariance_source=response.objects[0].covariance_source,
            angular_velocities=None if None in turning else np.array(turning),
            final_positions=None if final is None else np.array(final),
            times_s=np.array(response.times_s),
            colors=tuple(ball.color for ball in response.objects),
            model=response.model,
            frame_size=response.frame_size,
            frame_rate=response.frame_rate,
            warnings=tuple(response.warnings),
            timing_ms=response.timing_ms,
        )


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

    @classmethod
    def from_response(cls, response: SimulateResponse) -> "Simulation":
        """Turn the answer's lists and images into arrays."""
        files = response.frames
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
        )
