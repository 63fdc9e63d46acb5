# pyright: standard
"""Smoothed positions of one ball."""

import numpy as np
from jaxtyping import Bool, Float
from pykalman import KalmanFilter

SURPRISE = 4.0
"""Minimum second difference at a push, in standard deviations."""
PUSH = 1e4
"""Factor on the variance of the velocity at a push."""
LONGEST_GAP_S = 0.25
"""Longest gap, in seconds, within which one filter follows a ball."""
LEAST_NOISE_PX = 0.05


def smoothed(
    times_s: Float[np.ndarray, " seen"], positions_px: Float[np.ndarray, "seen 2"]
) -> Float[np.ndarray, "seen 2"]:
    """Smooth positions with a Kalman smoother of constant velocity.

    Noises are estimated from the differences of neighbouring frames. Where a way bends more than
    they explain, at a cushion or another ball, the velocity may change at once, so that impacts
    stay sharp.

    Parameters
    ----------
    times_s
        Ascending.
    positions_px
        Where the ball was seen, and only there: nothing is made up in between.
    """
    parts = np.split(np.arange(len(times_s)), np.flatnonzero(np.diff(times_s) > LONGEST_GAP_S) + 1)
    return np.concatenate([_part(times_s[part], positions_px[part]) for part in parts])


def _part(
    times_s: Float[np.ndarray, " seen"], positions_px: Float[np.ndarray, "seen 2"]
) -> Float[np.ndarray, "seen 2"]:
    if len(times_s) < 5:
        return positions_px
    spans = np.diff(times_s)
    steps = spans / np.median(spans)
    noise, change = _noises(positions_px)
    bends = np.linalg.norm(np.diff(positions_px, 2, axis=0), axis=1)
    surprising = bends > SURPRISE * np.sqrt(change**2 + 6 * noise**2)
    # A velocity changed in one of the two spans of a bend.
    pushed = np.append(surprising, False) | np.append(False, surprising)
    means, _ = _filter(steps, noise, change, pushed, positions_px[0]).smooth(positions_px)
    return np.asarray(means, np.float64)[:, :2]


def _noises(positions_px: Float[np.ndarray, "seen 2"]) -> tuple[float, float]:
    """Return the standard deviations of a measurement and of a velocity's change in a frame.

    Third differences of a smooth way are nearly noise alone, of variance 20 times its own.
    """
    third = np.abs(np.diff(positions_px, 3, axis=0))
    second = np.abs(np.diff(positions_px, 2, axis=0))
    noise = max(LEAST_NOISE_PX, float(np.median(third)) / (0.6745 * np.sqrt(20)))
    spread = float(np.median(second)) / 0.6745
    return noise, float(np.sqrt(max(spread**2 - 6 * noise**2, (0.3 * noise) ** 2)))


def _filter(
    steps: Float[np.ndarray, " spans"],
    noise: float,
    change: float,
    pushed: Bool[np.ndarray, " spans"],
    first: Float[np.ndarray, "2"],
) -> KalmanFilter:
    moves = np.tile(np.eye(4), (len(steps), 1, 1))
    moves[:, 0, 2] = moves[:, 1, 3] = steps
    variances = change**2 * np.where(pushed, PUSH, 1.0)
    drift = np.zeros((len(steps), 4, 4))
    for axis in (0, 1):
        # A velocity that walks at random between the frames.
        drift[:, axis, axis] = variances * steps**3 / 3
        drift[:, axis, axis + 2] = drift[:, axis + 2, axis] = variances * steps**2 / 2
        drift[:, axis + 2, axis + 2] = variances * steps
    return KalmanFilter(
        transition_matrices=moves,
        transition_covariance=drift,
        observation_matrices=np.eye(2, 4),
        observation_covariance=noise**2 * np.eye(2),
        initial_state_mean=[*first, 0, 0],
        initial_state_covariance=np.diag([noise**2, noise**2, 1e4, 1e4]),
    )
