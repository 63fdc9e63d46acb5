"""Steps between those of a network, against closed forms."""

import numpy as np
import pytest

from service.inference.step_times import StepTimes, frame_spacing, reads_rate
from tests.service.samples import manifest


def steps_of(count: int):
    """A network's steps: positions on a line, one number that belongs to no step."""
    for step in range(count):
        yield {
            "positions": np.full((1, 2, 2), 3.0 * step, np.float32),
            "covariances": np.full((1, 2, 2, 2), 1.0 + step, np.float32),
        }


@pytest.mark.parametrize("spacing", [1 / 3, 0.32, 0.5, 1.0, 4 / 3, 2.0, 2.667])
@pytest.mark.parametrize("horizon", [1, 2, 7, 40])
def test_every_step_lies_at_its_time(spacing, horizon):
    times = StepTimes(spacing, horizon)
    made = [one for outputs in steps_of(times.rollout_horizon) for one in times.add(outputs)]
    expected = 3 * spacing * np.arange(horizon)
    assert np.allclose([one["positions"][0, 1, 0] for one in made], expected, rtol=1e-5)
    assert np.allclose([one["covariances"][0, 0, 1, 1] for one in made], 1 + expected / 3)
    # The rollout is no longer than it has to be.
    assert times.rollout_horizon - 1 < (horizon - 1) * spacing + 1


def test_steps_are_handed_over_as_soon_as_the_network_has_passed_them():
    times = StepTimes(0.5, 6)
    counts = [len(times.add(outputs)) for outputs in steps_of(times.rollout_horizon)]
    assert counts == [1, 2, 2, 1]


def test_steps_of_the_network_are_its_own():
    times = StepTimes(1.0, 3)
    for outputs in steps_of(times.rollout_horizon):
        (made,) = times.add(outputs)
        assert made is outputs


@pytest.mark.parametrize(
    ("rate", "spacing"), [(40, 1), (30, 4 / 3), (15, 8 / 3), (120, 1 / 3), (5, 1), (400, 1)]
)
def test_a_model_is_told_the_rates_that_it_knows(rate, spacing):
    knows = manifest(frame_rates_hz=[15, 125])
    assert frame_spacing(knows, rate) == pytest.approx(spacing)
    assert frame_spacing(manifest(), rate) == 1
    assert not reads_rate(manifest(), rate)
