"""Kinematic forecasts against closed forms."""

import numpy as np
import pytest

from rollcast.kinematics import kinematic_forecast, mean_slopes

STEPS = np.arange(41)
SIGMAS = np.array([[0.3, 0.05]])


def observed(start, velocity):
    return (np.array(start) + np.arange(-3, 1)[:, None] * np.array(velocity))[None]


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (1.5, -0.25), (-6.0, 4.0)])
def test_a_ball_of_constant_velocity_goes_on(velocity):
    made = kinematic_forecast(observed((40, 60), velocity), SIGMAS, 0.1, STEPS)
    expected = np.array([40, 60]) + STEPS[:, None] * np.array(velocity)
    np.testing.assert_allclose(made.positions[0], expected, atol=0.02)


def test_forecasts_of_several_balls_are_those_of_each():
    paths = np.concatenate([observed((10, 20), (1, 2)), observed((90, 30), (-2, 0.5))])
    sigmas = np.array([[0.3, 0.05], [1.0, 0.2]])
    together = kinematic_forecast(paths, sigmas, 0.1, STEPS)
    for ball in range(2):
        alone = kinematic_forecast(paths[ball : ball + 1], sigmas[ball : ball + 1], 0.1, STEPS)
        np.testing.assert_allclose(together.positions[ball], alone.positions[0])
        np.testing.assert_allclose(together.covariances[ball], alone.covariances[0])


def test_steps_may_be_asked_for_one_at_a_time():
    path = observed((40, 60), (1.5, -0.25)) + np.random.default_rng(0).normal(0, 0.2, (1, 4, 2))
    whole = kinematic_forecast(path, SIGMAS, 0.1, STEPS)
    one = kinematic_forecast(path, SIGMAS, 0.1, np.array([17]))
    np.testing.assert_allclose(one.positions[:, 0], whole.positions[:, 17])
    np.testing.assert_allclose(one.covariances[:, 0], whole.covariances[:, 17])


def test_the_variance_is_that_of_place_velocity_and_accelerations():
    made = kinematic_forecast(observed((40, 60), (3, -4)), SIGMAS, 0.2, STEPS)
    speed = 5
    expected = 0.3**2 + 0.05**2 * STEPS**2.0 + (0.2 * speed) ** 2 * STEPS**3 / 3
    # The filter reads the speed to a thousandth.
    np.testing.assert_allclose(made.covariances[0, :, 0, 0], expected, rtol=3e-3)
    np.testing.assert_allclose(made.covariances[0, :, 1, 1], expected, rtol=3e-3)
    np.testing.assert_array_equal(made.covariances[0, :, 0, 1], 0)


def test_the_variance_holds_what_random_accelerations_do():
    generator = np.random.default_rng(3)
    sigma, balls, steps = 0.1, 4000, 20
    # White acceleration in small steps of time, after four places that are exact.
    fine = 50
    pushes = generator.normal(0, sigma / np.sqrt(fine), (balls, steps * fine))
    ways = pushes.cumsum(axis=1).cumsum(axis=1)[:, -1] / fine
    made = kinematic_forecast(observed((0, 0), (1, 0)), np.zeros((1, 2)), sigma, np.array([steps]))
    assert made.covariances[0, 0, 0, 0] == pytest.approx(ways.var(), rel=0.1)


def test_the_slope_under_a_path_is_the_mean_of_its_cells():
    ground = np.zeros((3, 4, 4))
    ground[0, :, 2:], ground[1, :, 2:] = 0.3, 0.4
    level = np.array([[-0.9, 0.0], [-0.2, 0.5]])
    half = np.array([[-0.5, 0.0], [0.5, 0.0]])
    beyond = np.array([[1.5, 0.0], [7.0, -3.0]])
    slopes = mean_slopes(ground, np.stack([level, half, beyond]))
    np.testing.assert_allclose(slopes, [0.0, 0.25, 0.5])


def test_a_ball_at_rest_is_where_it_was():
    made = kinematic_forecast(observed((40, 60), (0, 0)), SIGMAS, 0.2, STEPS)
    expected = 0.3**2 + 0.05**2 * STEPS**2.0
    np.testing.assert_allclose(made.covariances[0, :, 0, 0], expected, rtol=1e-3)
