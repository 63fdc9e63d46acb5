import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rollcast.perlin import noise_and_gradient, noise_derivatives

PERIOD = 256
coordinates = st.floats(-300, 300)


def noise(x: float, y: float) -> float:
    return noise_derivatives(x, y)[0]


@given(coordinates, coordinates)
@example(0.0, 0.0)
@example(3.0, -2.5)
@example(-1e-9, 255.99999)
def test_derivatives_agree_with_finite_differences(x, y):
    _, nx, ny, nxx, nxy, nyy = noise_derivatives(x, y)
    h = 1e-5
    right, left = noise_derivatives(x + h, y), noise_derivatives(x - h, y)
    above, below = noise_derivatives(x, y + h), noise_derivatives(x, y - h)
    # The third derivative jumps at the lattice, so differences across it are off by about h.
    assert nx == pytest.approx((right[0] - left[0]) / (2 * h), abs=1e-6)
    assert ny == pytest.approx((above[0] - below[0]) / (2 * h), abs=1e-6)
    assert nxx == pytest.approx((right[1] - left[1]) / (2 * h), abs=2e-3)
    assert nxy == pytest.approx((above[1] - below[1]) / (2 * h), abs=2e-3)
    assert nyy == pytest.approx((above[2] - below[2]) / (2 * h), abs=2e-3)


@given(st.integers(-300, 300), st.floats(-300, 300))
def test_height_slope_and_curvature_are_continuous_across_the_lattice(line, along):
    for before, after in (
        (noise_derivatives(line - 1e-9, along), noise_derivatives(line + 1e-9, along)),
        (noise_derivatives(along, line - 1e-9), noise_derivatives(along, line + 1e-9)),
    ):
        np.testing.assert_allclose(before, after, atol=1e-6)


@given(st.integers(-600, 600), st.integers(-600, 600))
def test_noise_is_zero_at_lattice_points_and_steep(i, j):
    n, nx, ny, *_ = noise_derivatives(i, j)
    assert n == 0
    assert np.hypot(nx, ny) == pytest.approx(1)


@given(coordinates, coordinates)
def test_the_landscape_repeats_after_its_period(x, y):
    assert noise(x + PERIOD, y - PERIOD) == pytest.approx(noise(x, y), abs=1e-9)


def test_many_points_at_once_agree_with_one_at_a_time():
    x, y = np.random.default_rng(0).uniform(-40, 40, (2, 7, 30))
    together = np.array(noise_and_gradient(x, y))
    alone = np.array([noise_derivatives(*point)[:3] for point in zip(x.flat, y.flat, strict=True)])
    np.testing.assert_allclose(together, alone.T.reshape(3, 7, 30), atol=1e-12)


def test_noise_stays_in_its_range_and_has_no_preferred_sign():
    x, y = np.random.default_rng(0).uniform(0, PERIOD, (2, 200_000))
    heights, slope_x, slope_y = noise_and_gradient(x, y)
    assert 0.6 < np.abs(heights).max() <= np.sqrt(0.5)
    for values in (heights, slope_x, slope_y):
        assert abs(values.mean()) < 0.02


def test_noise_has_a_fixed_landscape():
    assert noise(0.3, 0.7) == pytest.approx(-0.12486732848, abs=1e-11)
    assert noise(-17.25, 101.5) == pytest.approx(-0.24257994980, abs=1e-11)
    assert noise(200.5, 3.1) == pytest.approx(0.14307606152, abs=1e-11)
