"""The promise of accuracy, measured as a user would: scenes and forecasts over HTTP."""

import numpy as np
import pytest

from rollcast.client import Client, Simulation
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.data.splits import seeds

SCENES = 60
HORIZON = 20


LIMITS_PX = {"hemisphere": (2, 4), "ellipsoid": (2, 4), "heightfield": (4, 9)}
"""Mean distances at T=10 and T=20 that models keep on scenes of the scenarios they know."""


@pytest.fixture(scope="module", params=LIMITS_PX)
def scenes(request, address) -> tuple[str, list[Simulation]]:
    scenario = request.param
    steps = FIRST_FORECAST_FRAME + HORIZON
    with Client(address) as client:
        return scenario, [
            client.simulate(scenario, seed=seed, steps=steps) for seed in seeds("test", SCENES)
        ]


@pytest.mark.parametrize("model", ["posnet", "auto"])
def test_forecasts_keep_their_promise_on_test_scenes(client, scenes, model):
    scenario, simulations = scenes
    distances = np.array([distances_px(client, simulation, model) for simulation in simulations])
    error_10, error_20 = distances[:, 9].mean(), distances[:, 19].mean()
    print(f"{model}, {scenario}: {error_10:.2f} px at T=10, {error_20:.2f} px at T=20")
    limit_10, limit_20 = LIMITS_PX[scenario]
    assert error_10 <= limit_10
    assert error_20 <= limit_20


def distances_px(client, simulation: Simulation, model: str) -> np.ndarray:
    """Distance between forecast and truth at every step, in 128-pixel units."""
    seen = simulation.frames[:OBSERVED_FRAMES]
    forecast = client.predict(seen, horizon=HORIZON, model=model)
    difference = forecast.positions[0] - simulation.positions[0, FIRST_FORECAST_FRAME:]
    return np.linalg.norm(difference, axis=-1)
