"""Polynomials are exact on polynomials."""

import numpy as np
import pytest

from training.baselines.least_squares import POINTS, polynomial

TIMES = np.arange(-3, 40)[None, None, :, None]
START, SPEED, CHANGE = np.array([3.0, 5.0]), np.array([0.7, -0.2]), np.array([-0.03, 0.01])


@pytest.mark.parametrize(
    ("degree", "motion"),
    [(1, START + SPEED * TIMES), (2, START + SPEED * TIMES + CHANGE * TIMES**2)],
    ids=["line", "quadratic"],
)
def test_it_is_exact_on_such_motion(degree, motion):
    forecast = polynomial(motion[:, :, :POINTS], degree, 40)
    np.testing.assert_allclose(forecast, motion[:, :, 3:], atol=1e-8)


def test_the_line_is_the_least_squares_one():
    noisy = START + SPEED * TIMES + np.random.default_rng(1).normal(size=(1, 1, 43, 2))
    line = polynomial(noisy[:, :, :POINTS], 1, 40)
    for axis in (0, 1):
        slope, offset = np.polyfit(np.arange(-3, 7), noisy[0, 0, :POINTS, axis], 1)
        np.testing.assert_allclose(line[0, 0, :, axis], offset + slope * np.arange(40), atol=1e-8)
