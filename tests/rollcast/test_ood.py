"""How unlike frames look: against Gaussians that are known, and frames that are made by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rollcast.ood import MOVED_LEVELS, FrameStats, OodDetector, frame_stats, summed_up

GREY = np.full((4, 128, 128, 3), 100, np.uint8)


def ball_at(*columns: int, size: int = 12) -> np.ndarray:
    frames = np.stack([GREY[0]] * len(columns))
    for frame, column in zip(frames, columns, strict=True):
        frame[60 : 60 + size, column : column + size] = (200, 30, 30)
    return frames


def test_frames_at_rest_are_still_whatever_the_camera_adds():
    noise = np.random.default_rng(1).normal(0, 3, GREY.shape)
    assert frame_stats(GREY).is_still
    assert frame_stats((GREY + noise).round().astype(np.uint8)).is_still
    assert frame_stats(GREY).largest_change == 0


@pytest.mark.parametrize("size", [4, 12, 28], ids=lambda size: f"{size} px")
def test_a_ball_that_rolls_is_not_still(size):
    seen = frame_stats(ball_at(40, 43, 46, 49, size=size))
    assert not seen.is_still
    assert seen.largest_change >= MOVED_LEVELS


def test_a_final_frame_is_left_out():
    frames = ball_at(40, 43, 46, 49, 100)
    np.testing.assert_array_equal(frame_stats(frames).texture, frame_stats(frames[:4]).texture)


def test_the_thumbnail_is_the_mean_color_of_its_cells():
    frames = np.zeros_like(GREY)
    frames[:, :16, 112:] = (255, 51, 0)
    thumbnail = frame_stats(frames).thumbnail.reshape(8, 8, 3)
    np.testing.assert_allclose(thumbnail[0, 7], [1, 0.2, 0], atol=1e-6)
    assert np.count_nonzero(thumbnail) == 2


@given(st.integers(0, 7))
def test_the_texture_knows_neither_turns_nor_mirrors_beyond_its_fineness(number):
    frames = np.random.default_rng(3).integers(0, 256, GREY.shape, np.uint8)
    turned = np.rot90(frames, number % 4, axes=(1, 2))
    turned = turned[:, :, ::-1] if number > 3 else turned
    np.testing.assert_allclose(
        frame_stats(np.ascontiguousarray(turned)).texture[3:],
        frame_stats(frames).texture[3:],
        atol=1e-5,
    )


@pytest.fixture
def ood_detector() -> OodDetector:
    """Two kinds: the thumbnails' first colour about 0.2 and 0.6; every number has variance 1."""
    generator = np.random.default_rng(0)
    components = np.linalg.qr(generator.normal(size=(192, 3)))[0].T
    thumbnails = np.stack([np.full(192, level) for level in (0.2, 0.6)])
    return OodDetector(
        thumbnails.astype(np.float32),
        np.stack([components] * 2).astype(np.float32),
        np.zeros((2, 11), np.float32),
        np.stack([np.eye(11), 2 * np.eye(11)]).astype(np.float32),
    )


def some_stats(level: float) -> FrameStats:
    generator = np.random.default_rng(1)
    thumbnail = level + 0.01 * generator.normal(size=192)
    return FrameStats(thumbnail.astype(np.float32), np.zeros(7, np.float32), 10)


def test_the_score_is_the_distance_from_the_nearest_kind(ood_detector):
    for level in (0.2, 0.6):
        seen = some_stats(level)
        parts = [
            summed_up(seen, *basis)
            for basis in zip(ood_detector.thumbnail, ood_detector.components, strict=True)
        ]
        # Whitened by 1 and by 2: the root of the mean square of the numbers, and twice that.
        expected = [np.sqrt(np.mean(parts[0] ** 2)), 2 * np.sqrt(np.mean(parts[1] ** 2))]
        np.testing.assert_allclose(ood_detector.scores(seen), expected, rtol=1e-5)
        assert ood_detector.score(seen) == min(ood_detector.scores(seen))


def test_what_the_components_leave_is_a_number_of_its_own(ood_detector):
    basis = ood_detector.thumbnail[0], ood_detector.components[0]
    along = FrameStats(basis[0] + 0.3 * basis[1][1], np.zeros(7, np.float32), 0)
    np.testing.assert_allclose(summed_up(along, *basis)[:3], [0, 0.3, 0], atol=1e-6)
    assert summed_up(along, *basis)[3] == pytest.approx(np.log(1e-3), abs=0.01)


def test_it_is_written_and_read(ood_detector, tmp_path):
    path = tmp_path / "ood.npz"
    ood_detector.write(path)
    again = OodDetector.read(path)
    assert again.score(some_stats(0.3)) == pytest.approx(ood_detector.score(some_stats(0.3)))
