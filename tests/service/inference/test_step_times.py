"""Steps between those of a network, against closed forms."""

import numpy as np
import pytest

from service.inference.step_times import StepTimes, frame_spacing, reads_rate
from tests.service.samples import manifest


def steps_of(count: int, together: int = 1):
    """A network's steps, some at a time: positions on a line, growing covariances."""
    for first in range(0, count, together):
        steps = np.arange(first, min(first + together, count), dtype=np.float32)
        yield {
            "positions": (3 * steps)[:, None, None, None] * np.ones((1, 1, 2, 2), np.float32),
            "covariances": (1 + steps)[:, None, None, None, None]
            * np.ones((1, 1, 2, 2, 2), np.float32),
        }


@pytest.mark.parametrize("spacing", [1 / 3, 0.32, 0.5, 1.0, 4 / 3, 2.0, 2.667])
@pytest.mark.parametrize("horizon", [1, 2, 7, 40])
@pytest.mark.parametrize("together", [1, 3, 8])
def test_every_step_lies_at_its_time(spacing, horizon, together):
    times = StepTimes(spacing, horizon)
    made = [times.add(outputs) for outputs in steps_of(times.rollout_horizon, together)]
    positions, covariances = (
        np.concatenate([one[name] for one in made]) for name in ("positions", "covariances")
    )
    expected = 3 * spacing * np.arange(horizon)
    assert np.allclose(positions[:, 0, 1, 0], expected, rtol=1e-5)
    assert np.allclose(covariances[:, 0, 0, 1, 1], 1 + expected / 3, rtol=1e-5)
    # The rollout is no longer than it has to be.
    assert times.rollout_horizon - 1 < (horizon - 1) * spacing + 1


def test_steps_are_handed_over_as_soon_as_the_network_has_passed_them():
    times = StepTimes(0.5, 6)
    counts = [len(times.add(outputs)["positions"]) for outputs in steps_of(times.rollout_horizon)]
    assert counts == [1, 2, 2, 1]


def test_steps_of_the_network_are_its_own():
    times = StepTimes(1.0, 3)
    for outputs in steps_of(times.rollout_horizon):
        assert times.add(outputs) is outputs


def test_a_step_on_one_of_the_networks_is_finite_where_the_next_is_not():
    times = StepTimes(2.0, 3)
    steps = {"positions": np.array([0, 1, 2, np.nan, np.nan])[:, None, None, None]}
    assert times.add(steps)["positions"][:2].ravel().tolist() == [0, 2]


@pytest.mark.parametrize(
    ("rate", "spacing"), [(40, 1), (30, 4 / 3), (15, 8 / 3), (120, 1 / 3), (5, 1), (400, 1)]
)
def test_a_model_is_told_the_rates_that_it_knows(rate, spacing):
    knows = manifest(frame_rates_hz=[15, 125])
    assert frame_spacing(knows, rate) == pytest.approx(spacing)
    assert frame_spacing(manifest(), rate) == 1
    assert not reads_rate(manifest(), rate)
