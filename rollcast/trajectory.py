"""Trajectories and the time convention: their only home.

Time t = 0 is the last of the four observed frames, so frames t = -3..0 are seen and a forecast of
horizon T has the steps t = 0..T-1. "Error at T" is the error at step T - 1.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

FRAME_RATE_HZ = 40
STEP_TOLERANCE = 0.5
"""Share of a step by which a frame may be off a forecast's last step and still be shown with it."""
OBSERVED_FRAMES = 4
"""Frames that a forecast sees (T_0 in the paper)."""

FIRST_FORECAST_FRAME = OBSERVED_FRAMES - 1
"""Index, in a sequence that starts with the observed frames, of forecast step 0."""


@dataclass(frozen=True)
class Trajectory:
    """States of the balls of one scene in every frame.

    Attributes
    ----------
    positions_m
        Ball centres in the world, metres.
    orientations_xyzw
        Unit quaternions (x, y, z, w) that turn body axes into world axes.
    angular_velocities_rad_s
        World axes, rad/s.
    """

    positions_m: Float[np.ndarray, "frames objects 3"]
    orientations_xyzw: Float[np.ndarray, "frames objects 4"]
    angular_velocities_rad_s: Float[np.ndarray, "frames objects 3"]

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.positions_m)

    def window(self, start: int, frames: int) -> "Trajectory":
        """Return ``frames`` consecutive frames from index ``start``.

        Raises
        ------
        IndexError
            When the trajectory is too short.
        """
        if start < 0 or start + frames > self.frames:
            raise IndexError(
                f"frames {start}..{start + frames - 1} requested from a trajectory with "
                f"{self.frames}"
            )
        part = slice(start, start + frames)
        return Trajectory(
            self.positions_m[part],
            self.orientations_xyzw[part],
            self.angular_velocities_rad_s[part],
        )
