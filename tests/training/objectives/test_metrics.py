import numpy as np

from training.objectives.metrics import Forecasts, constant_positions


def test_staying_put_repeats_the_first_step():
    positions = np.random.default_rng(0).normal(size=(2, 1, 6, 2))
    assert (constant_positions(positions) == positions[:, :, :1]).all()


def test_a_gaussian_forecast_of_gaussian_truth_is_calibrated():
    generator = np.random.default_rng(0)
    covariance = np.array([[4.0, 1.5], [1.5, 2.0]])
    truth = generator.multivariate_normal([0, 0], covariance, size=(20_000, 1, 1))
    forecasts = Forecasts(
        positions=np.zeros_like(truth),
        covariances=np.broadcast_to(covariance, (20_000, 1, 1, 2, 2)).copy(),
        angular_velocities=None,
        true_positions=truth,
        true_angular_velocities=np.zeros((20_000, 1, 1, 3)),
    )
    coverage = forecasts.calibration((0.50, 0.95))
    assert coverage is not None
    np.testing.assert_allclose(coverage[0.50], 0.50, atol=0.02)
    np.testing.assert_allclose(coverage[0.95], 0.95, atol=0.01)
    entropy = np.log(2 * np.pi * np.e) + 0.5 * np.log(np.linalg.det(covariance))
    np.testing.assert_allclose(forecasts.nll_nats(), entropy, atol=0.03)


def test_errors_and_spin_by_hand():
    forecasts = Forecasts(
        positions=np.array([[[[3.0, 4.0]]], [[[0.0, 0.0]]]]),
        covariances=None,
        angular_velocities=np.array([[[[1.0, 2.0, 2.0]]], [[[0.0, 0.0, 0.0]]]]),
        true_positions=np.zeros((2, 1, 1, 2)),
        true_angular_velocities=np.zeros((2, 1, 1, 3)),
    )
    assert forecasts.errors_px().ravel().tolist() == [5.0, 0.0]
    np.testing.assert_allclose(forecasts.angular_velocity_rmse(), np.sqrt(9 / 2))
