import numpy as np
import pytest

from rollcast.patches import PATCH_SIZE, Letterbox, cut_patches, half_widths, letterboxed


def ramp(height: int, width: int) -> np.ndarray:
    """Frames whose red is the column and whose green is the row, of pixel centres."""
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    frame = np.stack([columns, rows, 0 * rows], axis=-1).astype(np.uint8)
    return np.stack([frame] * 4)


@pytest.mark.parametrize(("height", "width"), [(128, 128), (90, 200), (200, 90)])
def test_a_patch_shows_what_lies_around_its_centre(height, width):
    box = Letterbox(height, width)
    centre = np.array([61.25, 44.75])
    points = box.points(np.broadcast_to(centre, (1, 4, 2)))
    half_px = 12.0
    (patch,) = cut_patches(ramp(height, width), points, np.array([half_px / (box.side / 2)]))
    along = (np.arange(PATCH_SIZE) + 0.5) * (2 * half_px / PATCH_SIZE) - half_px
    red, green = (127.5 * (patch[0, channel] + 1) for channel in (0, 1))
    # The value of a pixel's centre, half a pixel inside, is its index.
    assert np.allclose(red, (centre[0] + along - 0.5)[None], atol=1e-3)
    assert np.allclose(green, (centre[1] + along - 0.5)[:, None], atol=1e-3)


def test_beyond_the_frame_its_border_goes_on():
    frames = np.full((4, 64, 64, 3), 200, np.uint8)
    points = np.array([[[-1.4, 0.9]] * 4])
    assert np.allclose(cut_patches(frames, points, np.array([0.5])), 200 / 127.5 - 1, atol=1e-5)


def test_a_wide_patch_averages_instead_of_skipping_pixels():
    generator = np.random.default_rng(3)
    frames = generator.integers(0, 256, (4, 512, 512, 3), dtype=np.uint8)
    patch = cut_patches(frames, np.zeros((1, 4, 2)), np.array([1.0]))
    # A sample of 16 x 16 pixels, weighted by a triangle twice as wide: noise shrinks by far.
    assert patch.std() < 0.1 * (frames / 127.5).std()
    assert abs(patch.mean() - (frames / 127.5 - 1).mean()) < 0.01


def test_large_balls_have_patches_as_large_and_small_ones_a_least_width():
    widths = half_widths(np.array([1e-3, 0.2, 0.4]))
    assert widths[2] == pytest.approx(2 * widths[1])
    assert 0 < widths[0] < widths[1]


def test_pixels_and_points_of_the_square_are_inverse():
    box = Letterbox(720, 1280)
    pixels = np.array([[0.0, 0.0], [1280, 720], [640, 360]])
    assert np.allclose(box.pixels(box.points(pixels)), pixels)
    assert np.allclose(box.points(pixels)[0], [-1, -0.5625])


@pytest.mark.parametrize(
    "size", [(128, 128), (256, 256), (200, 300), (333, 171), (60, 40), (129, 128)]
)
def test_a_letterboxed_spot_is_where_the_letterbox_says(size):
    height, width = size
    y, x = np.mgrid[:height, :width] + 0.5
    box = Letterbox(height, width)
    at = np.array([0.6 * width, 0.3 * height])
    spread = 0.05 * box.side
    spot = 255 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * spread**2))
    frames = np.repeat(spot[None, ..., None], 3, axis=-1).round().astype(np.uint8)
    (square,) = letterboxed(frames, 128)[..., 0].astype(float)
    rows, columns = np.mgrid[:128, :128] + 0.5
    found = np.array([(square * columns).sum(), (square * rows).sum()]) / square.sum()
    assert np.allclose(found, 64 + 64 * box.points(at), atol=0.6)


def test_frames_of_the_size_are_not_touched():
    frames = np.random.default_rng(1).integers(0, 256, (4, 128, 128, 3), dtype=np.uint8)
    assert letterboxed(frames, 128) is frames
