"""States between the frames of a simulation, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rollcast.trajectory import Trajectory
from training.data.frame_spacing import SPACINGS_MS, draw_spacing, earliest_start, seen_states

SPIN = np.array([0.0, 4.0, 8.0])
FRAMES = np.arange(40.0)


def falling() -> Trajectory:
    """A ball of constant acceleration and constant spin."""
    path = np.stack([0.3 * FRAMES - 0.01 * FRAMES**2, 0.02 * FRAMES, 0.5 + 0 * FRAMES], axis=-1)
    turns = Rotation.from_rotvec(FRAMES[:, None] / 40 * SPIN).as_quat()
    return Trajectory(path[:, None], turns[:, None], np.tile(SPIN, (40, 1, 1)))


@pytest.mark.parametrize("spacing", [0.32, 0.5, 0.9, 1.0, 1.3, 2.0, 2.68])
def test_four_frames_end_at_the_same_frame_with_every_spacing(spacing):
    seen = seen_states(falling(), 20, spacing)
    moments = 23 - spacing * np.array([3, 2, 1, 0])
    expected = 0.3 * moments - 0.01 * moments**2
    assert np.allclose(seen.positions_m[:, 0, 0], expected, atol=1e-9)
    turned = Rotation.from_quat(seen.orientations_xyzw[:, 0])
    true = Rotation.from_rotvec(moments[:, None] / 40 * SPIN)
    assert np.allclose((turned * true.inv()).magnitude(), 0, atol=1e-6)
    assert np.allclose(seen.angular_velocities_rad_s, SPIN)


def test_frames_of_a_simulation_are_its_own():
    whole = falling()
    assert np.array_equal(seen_states(whole, 7, 1.0).positions_m, whole.positions_m[7:11])
    assert np.allclose(seen_states(whole, 7, 2.0).positions_m[1:], whole.positions_m[6:11:2])


def test_a_window_cannot_begin_before_its_simulation():
    for spacing in (1.5, 2.68):
        first = earliest_start(spacing)
        assert first + 3 - 3 * spacing >= 0
        seen_states(falling(), first, spacing)
        with pytest.raises(IndexError):
            seen_states(falling(), first - 1, spacing)
    assert earliest_start(0.3) == 0


def test_spacings_cover_15_to_125_frames_a_second():
    generator = np.random.default_rng(0)
    rates = 40 / np.array([draw_spacing(generator) for _ in range(2000)])
    assert SPACINGS_MS == (8, 67)
    assert 14.9 < rates.min() < 15.5
    assert 120 < rates.max() <= 125
    assert 0.4 < np.mean(rates < 43.3) < 0.6  # the geometric mean of both ends
