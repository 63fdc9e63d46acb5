"""Fits the random accelerations of kinematic forecasts to simulated tables (decision 0146)."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.kinematics import filtered
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.data.shards import Source, load_recordings, simulate_split

STEPS = np.array([3, 5, 10, 15, 20, 30, 40])
PLACE_PX, VELOCITY_PX = 0.1, 0.08
"""Standard deviations of a place, and of a velocity, that the perception reads."""
OUTLIER = 5.0
"""Distance in standard deviations from which an error counts linearly: balls that are hit."""
WINDOWS_A_SCENE = 6
LATEST_START = 140
SEED = 146
LARGEST_RATIO = 2.0


def fit_acceleration_ratio(scenes: int, workers: int) -> float:
    """Return the ratio of highest likelihood on tables of the validation split.

    Parameters
    ----------
    scenes
        Of tables with one, two and three balls each.
    """
    errors, speeds = _errors_and_speeds(scenes, workers)
    found = minimize_scalar(
        lambda ratio: _nll(ratio, errors, speeds), bounds=(0, LARGEST_RATIO), method="bounded"
    )
    return round(float(found.x), 3)


def _nll(
    ratio: float, errors: Float[np.ndarray, "balls steps"], speeds: Float[np.ndarray, " balls"]
) -> float:
    """Mean negative log likelihood of squared errors, without its constant."""
    accelerations = (ratio * speeds)[:, None] ** 2
    variances = PLACE_PX**2 + (VELOCITY_PX * STEPS) ** 2 + accelerations * STEPS**3 / 3
    squared = errors / variances
    linear = 2 * OUTLIER * np.sqrt(np.maximum(squared, OUTLIER**2)) - OUTLIER**2
    robust = np.where(squared < OUTLIER**2, squared, linear)
    return float((np.log(variances) + robust / 2).mean())


def _errors_and_speeds(
    scenes: int, workers: int
) -> tuple[Float[np.ndarray, "balls steps"], Float[np.ndarray, " balls"]]:
    """Squared errors of straight lines through noisy places, and the speeds that were read."""
    generator = np.random.default_rng(SEED)
    camera = camera_for("table", NETWORK_FRAME_SIZE)
    errors: list[np.ndarray] = []
    speeds: list[np.ndarray] = []
    for objects in (1, 2, 3):
        shards = simulate_split(Source("table", objects), "validation", scenes, workers)
        for recording in load_recordings(shards):
            paths = camera.project(recording.trajectory.positions_m).swapaxes(0, 1)
            for start in generator.integers(LATEST_START, size=WINDOWS_A_SCENE):
                seen = paths[:, start : start + OBSERVED_FRAMES]
                place, velocity = filtered(seen + generator.normal(0, PLACE_PX, seen.shape))
                truth = paths[:, start + FIRST_FORECAST_FRAME + STEPS]
                line = place[:, None] + STEPS[:, None] * velocity[:, None]
                shown = ((seen >= 0) & (seen <= NETWORK_FRAME_SIZE)).all(axis=(1, 2))
                errors.append(np.square(truth - line).sum(axis=-1)[shown])
                speeds.append(np.linalg.norm(velocity, axis=-1)[shown])
    return np.concatenate(errors), np.concatenate(speeds)
