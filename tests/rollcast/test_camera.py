import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rollcast.camera import NETWORK_FRAME_SIZE, Camera, camera_for
from rollcast.scene import SCENARIOS

cameras = st.builds(
    Camera,
    half_width_m=st.floats(0.1, 10),
    image_size=st.integers(32, 4096),
)
metres = st.floats(-20, 20)


@given(cameras, metres, metres, metres)
def test_positions_survive_the_way_to_the_image_and_back(camera, x, y, z):
    there = camera.project(np.array([x, y, z]))
    np.testing.assert_allclose(camera.unproject(there), [x, y], atol=1e-12)


@given(cameras, metres, metres, metres, metres)
def test_height_is_lost_in_projection(camera, x, y, low, high):
    np.testing.assert_array_equal(
        camera.project(np.array([x, y, low])), camera.project(np.array([x, y, high]))
    )


@given(cameras)
def test_the_visible_square_fills_the_image_from_corner_to_corner(camera):
    half, size = camera.half_width_m, camera.image_size
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    np.testing.assert_allclose(
        camera.project(corners), [[0, 0], [size, 0], [size, size], [0, size]], atol=1e-9
    )


def test_world_y_is_image_up():
    camera = Camera(half_width_m=1, image_size=100)
    middle, right, up = camera.project(np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]]))
    np.testing.assert_allclose(middle, [50, 50])
    np.testing.assert_allclose(right - middle, [25, 0])
    np.testing.assert_allclose(up - middle, [0, -25])


@pytest.mark.parametrize("size", [32, 45, 128])
def test_pixel_centres_lie_half_a_pixel_from_the_corner(size):
    camera = Camera(half_width_m=1.05, image_size=size)
    x, y = camera.pixel_centres_m()
    assert x.shape == y.shape == (size, size)
    centres = camera.project(np.stack([x, y, np.zeros_like(x)], axis=-1))
    rows, columns = np.indices((size, size))
    np.testing.assert_allclose(centres[..., 0], columns + 0.5, atol=1e-9)
    np.testing.assert_allclose(centres[..., 1], rows + 0.5, atol=1e-9)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_frames_span_what_the_design_says(scenario):
    half = 1.25 if scenario in ("heightfield", "table") else 1.05
    camera = camera_for(scenario, 128)
    np.testing.assert_allclose(camera.unproject(np.array([0.0, 0.0])), [-half, half])
    np.testing.assert_allclose(camera.unproject(np.array([128.0, 128.0])), [half, -half])


def test_networks_see_128_pixels_through_a_camera_that_stays():
    assert NETWORK_FRAME_SIZE == 128
    with pytest.raises(AttributeError):
        camera_for("hemisphere", 128).image_size = 64
