"""Frames at even times from frames at others: each tells its time by its brightness."""

import numpy as np
import pytest

from rollcast.errors import FootageError
from rollcast.footage import Footage, SquareCrop, TakenFrame, resample

DARK, BRIGHT = (np.full((8, 8, 3), level, np.uint8) for level in (40, 200))


def footage(rate, count):
    """A second is 100 levels of brightness."""
    times_s = np.arange(count) / rate
    frames = np.stack([np.full((8, 8, 3), round(100 * time_s), np.uint8) for time_s in times_s])
    return Footage(frames, times_s, SquareCrop(5, 6, 8))


@pytest.mark.parametrize("rate", [20, 30, 40, 50, 60, 120])
def test_even_times_from_any_rate(rate):
    resampled = footage(rate, 30).resampled(40, 4)
    np.testing.assert_allclose(resampled.times_s, np.arange(4) / 40)
    np.testing.assert_allclose(resampled.frames.mean(axis=(1, 2, 3)), [0, 2.5, 5, 7.5], atol=0.5)
    assert resampled.frame_rate == pytest.approx(40)
    assert resampled.crop == SquareCrop(5, 6, 8)
    assert resampled.blended_over_s == pytest.approx(0 if rate in {40, 120} else 1 / rate)


def test_footage_that_ends_too_soon_is_refused():
    with pytest.raises(
        FootageError, match=r"end after 0\.060 s; 4 frames, 40 a second, need 0\.075"
    ):
        footage(50, 4).resampled(40, 4)


@pytest.mark.parametrize(
    ("time_s", "level", "shown_s"),
    [(1.0, 40, 1.0), (1.05, 80, 1.05), (1.1, 120, 1.1), (1.2, 200, 1.2), (1.195, 200, 1.2)],
)
def test_a_picture_between_two_is_their_mean_by_time(time_s, level, shown_s):
    taken = [TakenFrame(1.0, lambda: DARK), TakenFrame(1.2, lambda: BRIGHT)]
    [moment] = resample(taken, [time_s], 0.01)
    assert (moment.picture == level).all()
    assert moment.time_s == pytest.approx(shown_s)
    assert (moment.blended_over_s > 0) == (level not in {40, 200})
