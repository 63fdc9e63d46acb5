"""Kinematic forecasts of balls by a Kalman filter of constant velocity.

The filter needs no ground map. On level ground its errors are smaller than those of networks that
were trained on bowls and heightfields.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

NOISE_RATIO = 0.2
"""Variance of the acceleration relative to that of an observed place, in the filter."""
UNKNOWN_SPEED = 100.0
"""Standard deviation of the speed before the first frame, relative to that of a place."""


class KinematicForecast(NamedTuple):
    """Places and covariances of N balls at T steps, in the units of the observed places."""

    positions: Float[np.ndarray, "N T 2"]
    covariances: Float[np.ndarray, "N T 2 2"]


def kinematic_forecast(
    places: Float[np.ndarray, "N K 2"],
    sigmas: Float[np.ndarray, "N 2"],
    acceleration_ratio: float,
    steps: Float[np.ndarray, " T"],
) -> KinematicForecast:
    """Forecast balls of constant velocity.

    Parameters
    ----------
    places
        Observed places of N balls, the last at step 0.
    sigmas
        Standard deviations of each ball's last place, and of its last displacement.
    acceleration_ratio
        Standard deviation of the change of velocity per step, relative to the speed. A fast ball
        meets more that slows or deflects it; one at rest stays where it is (decision 0146).
    steps
        Steps to forecast, which may lie between those of the observed places.
    """
    place, velocity = _filtered(np.asarray(places, float))
    ahead = np.asarray(steps, float)
    positions = place[:, None] + ahead[:, None] * velocity[:, None]
    of_place, of_velocity = np.square(sigmas).T[:, :, None]
    acceleration = acceleration_ratio * np.linalg.norm(velocity, axis=-1)[:, None]
    variances = of_place + of_velocity * ahead**2 + acceleration**2 * ahead**3 / 3
    return KinematicForecast(positions, variances[..., None, None] * np.eye(2))


def _filtered(
    places: Float[np.ndarray, "N K 2"],
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N 2"]]:
    """Return place and velocity at the last observed step."""
    motion = np.array([[1.0, 1.0], [0.0, 1.0]])
    noise = NOISE_RATIO * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    covariance = np.diag([1.0, UNKNOWN_SPEED**2])
    place, velocity = places[:, 0], np.zeros_like(places[:, 0])
    for seen in np.moveaxis(places, 1, 0)[1:]:
        covariance = motion @ covariance @ motion.T + noise
        gain = covariance[:, 0] / (covariance[0, 0] + 1)
        covariance = covariance - np.outer(gain, covariance[0])
        surprise = seen - (place + velocity)
        place = place + velocity + gain[0] * surprise
        velocity = velocity + gain[1] * surprise
    return place, velocity


def mean_slopes(
    ground: Float[np.ndarray, "3 cells cells"], paths: Float[np.ndarray, "N T 2"]
) -> Float[np.ndarray, " N"]:
    """Return the mean slope of the ground under the paths of balls.

    Parameters
    ----------
    ground
        Slopes along x and along y, and the height, of cells that fill the square.
    paths
        Points of the square, -1 to 1; beyond it, the outermost cells count.
    """
    cells = ground.shape[-1]
    x, y = np.moveaxis(np.clip(((paths + 1) * (cells / 2)).astype(int), 0, cells - 1), -1, 0)
    return np.hypot(ground[0, y, x], ground[1, y, x]).mean(axis=-1)
