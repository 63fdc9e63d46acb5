"""The promise of accuracy, measured as a user would: scenes and forecasts over HTTP."""

import numpy as np
import pytest

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.splits import seeds

SCENES = 60
HORIZON = 20


@pytest.mark.parametrize(
    ("scenario", "limit_10", "limit_20"),
    [("hemisphere", 4, 8), ("ellipsoid", 4, 8), ("heightfield", 6, 12)],
)
def test_posnet_keeps_its_promise_on_test_scenes(client, scenario, limit_10, limit_20):
    distances = np.array(
        [posnet_distances(client, scenario, seed) for seed in seeds("test", SCENES)]
    )
    error_10, error_20 = distances[:, 9].mean(), distances[:, 19].mean()
    print(f"{scenario}: {error_10:.2f} px at T=10, {error_20:.2f} px at T=20")
    assert error_10 <= limit_10
    assert error_20 <= limit_20


def posnet_distances(client, scenario: str, seed: int) -> np.ndarray:
    """Distance between forecast and truth at every step, in 128-pixel units."""
    sequence = client.simulate(scenario, seed=seed, steps=FIRST_FORECAST_FRAME + HORIZON)
    forecast = client.predict(sequence.frames[:OBSERVED_FRAMES], horizon=HORIZON, model="posnet")
    difference = forecast.positions[0] - sequence.positions[0, FIRST_FORECAST_FRAME:]
    return np.linalg.norm(difference, axis=-1)
