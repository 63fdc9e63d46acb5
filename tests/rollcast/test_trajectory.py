import numpy as np
import pytest

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES, Trajectory


def numbered(frames: int) -> Trajectory:
    """A trajectory of two balls whose every number tells its frame."""
    count = np.arange(frames, dtype=float)[:, None, None]
    return Trajectory(
        count + np.zeros((frames, 2, 3)),
        100 + count + np.zeros((frames, 2, 4)),
        200 + count + np.zeros((frames, 2, 3)),
    )


def test_forecast_step_zero_is_the_last_seen_frame():
    seen = numbered(50).window(10, OBSERVED_FRAMES)
    steps = numbered(50).window(10 + FIRST_FORECAST_FRAME, 20)
    np.testing.assert_array_equal(steps.positions_m[0], seen.positions_m[-1])


def test_a_window_cuts_every_part_alike():
    part = numbered(9).window(2, 3)
    assert part.frames == 3
    np.testing.assert_array_equal(part.positions_m[:, 1, 0], [2, 3, 4])
    np.testing.assert_array_equal(part.orientations_xyzw[:, 0, 3], [102, 103, 104])
    np.testing.assert_array_equal(part.angular_velocities_rad_s[:, 1, 2], [202, 203, 204])


def test_the_whole_is_a_window():
    np.testing.assert_array_equal(numbered(9).window(0, 9).positions_m, numbered(9).positions_m)


@pytest.mark.parametrize(("start", "frames"), [(-1, 3), (0, 10), (9, 1), (7, 3)])
def test_a_window_beyond_the_ends_is_refused(start, frames):
    with pytest.raises(IndexError, match=r"requested from a trajectory with 9"):
        numbered(9).window(start, frames)
