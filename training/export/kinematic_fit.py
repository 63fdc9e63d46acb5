"""Fits the random accelerations of kinematic forecasts to simulated tables (decision 0146)."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.kinematics import kinematic_forecast
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
    seen, truths = _windows(scenes, workers)
    found = minimize_scalar(
        lambda ratio: _nll(ratio, seen, truths), bounds=(0, LARGEST_RATIO), method="bounded"
    )
    return round(float(found.x), 3)


def _nll(
    ratio: float, seen: Float[np.ndarray, "balls 4 2"], truths: Float[np.ndarray, "balls steps 2"]
) -> float:
    """Mean negative log likelihood of the true places, without its constant."""
    sigmas = np.tile([PLACE_PX, VELOCITY_PX], (len(seen), 1))
    made = kinematic_forecast(seen, sigmas, ratio, STEPS)
    variances = made.covariances[..., 0, 0]
    squared = np.square(truths - made.positions).sum(axis=-1) / variances
    linear = 2 * OUTLIER * np.sqrt(np.maximum(squared, OUTLIER**2)) - OUTLIER**2
    robust = np.where(squared < OUTLIER**2, squared, linear)
    return float((np.log(variances) + robust / 2).mean())


def _windows(
    scenes: int, workers: int
) -> tuple[Float[np.ndarray, "balls 4 2"], Float[np.ndarray, "balls steps 2"]]:
    """Return the noisy places of balls that are in view, and where they went."""
    generator = np.random.default_rng(SEED)
    camera = camera_for("table", NETWORK_FRAME_SIZE)
    seen: list[np.ndarray] = []
    truths: list[np.ndarray] = []
    for objects in (1, 2, 3):
        shards = simulate_split(Source("table", objects), "validation", scenes, workers)
        for recording in load_recordings(shards):
            paths = camera.project(recording.trajectory.positions_m).swapaxes(0, 1)
            for start in generator.integers(LATEST_START, size=WINDOWS_A_SCENE):
                places = paths[:, start : start + OBSERVED_FRAMES]
                shown = ((places >= 0) & (places <= NETWORK_FRAME_SIZE)).all(axis=(1, 2))
                seen.append((places + generator.normal(0, PLACE_PX, places.shape))[shown])
                truths.append(paths[:, start + FIRST_FORECAST_FRAME + STEPS][shown])
    return np.concatenate(seen), np.concatenate(truths)
