"""Seen frames at another rate than a simulation's: its states between two of its frames."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES, Trajectory

SPACINGS_MS = (8.0, 67.0)
"""Shortest and longest time between two seen frames that training draws: 125 to 15 a second."""


def draw_spacing(generator: np.random.Generator) -> float:
    """Draw the time between two seen frames, in frames of a simulation; logarithms are even."""
    shortest, longest = np.log(SPACINGS_MS)
    return float(np.exp(generator.uniform(shortest, longest))) * FRAME_RATE_HZ / 1000


def earliest_start(spacing: float) -> int:
    """Return the first frame at which a window can begin, counted as with a spacing of 1."""
    return max(int(np.ceil(FIRST_FORECAST_FRAME * (spacing - 1))), 0)


def seen_states(trajectory: Trajectory, start: int, spacing: float) -> Trajectory:
    """Return the states in the four seen frames of a window.

    Parameters
    ----------
    start
        Frame of t = -3 if the spacing were 1; t = 0 is the same frame with every spacing.
    spacing
        Time between two seen frames, in frames of the simulation.

    Raises
    ------
    IndexError
        When the trajectory has not begun by then.
    """
    last = start + FIRST_FORECAST_FRAME
    if spacing == 1:
        return trajectory.window(start, OBSERVED_FRAMES)
    if start < earliest_start(spacing):
        raise IndexError(f"a window with the spacing {spacing:g} cannot begin at frame {start}")
    return states_at(
        trajectory.window(0, last + 1), last - spacing * np.arange(OBSERVED_FRAMES)[::-1]
    )


def states_at(trajectory: Trajectory, moments: Float[np.ndarray, " moments"]) -> Trajectory:
    """Return the states at ascending moments between frames.

    Positions follow a cubic and orientations the shortest turn.
    """
    first = max(int(np.floor(moments[0])) - 1, 0)
    last = min(int(np.ceil(moments[-1])) + 1, trajectory.frames - 1)
    states, moments = trajectory.window(first, last - first + 1), moments - first
    frames = np.arange(states.frames)
    slopes = np.gradient(states.positions_m, axis=0, edge_order=2)
    spins = states.angular_velocities_rad_s
    turns = [
        Slerp(frames, Rotation.from_quat(ball))(moments).as_quat()
        for ball in states.orientations_xyzw.swapaxes(0, 1)
    ]
    before = np.minimum(moments.astype(int), states.frames - 2)
    share = (moments - before)[:, None, None]
    return Trajectory(
        CubicHermiteSpline(frames, states.positions_m, slopes)(moments),
        np.stack(turns, axis=1),
        (1 - share) * spins[before] + share * spins[before + 1],
    )
