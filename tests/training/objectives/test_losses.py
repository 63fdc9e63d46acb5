import pytest
import torch

from training.networks.recurrent import Observation
from training.objectives.losses import (
    DistanceLoss,
    LikelihoodLoss,
    SpinLoss,
    negative_log_likelihood,
    step_weights,
)


def test_likelihood_is_that_of_a_bivariate_normal():
    generator = torch.Generator().manual_seed(0)
    mean, truth = torch.randn(2, 30, 2, generator=generator)
    root = torch.randn(30, 2, 2, generator=generator)
    covariance = root @ root.mT + 0.1 * torch.eye(2)
    normal = torch.distributions.MultivariateNormal(mean, covariance)
    torch.testing.assert_close(
        negative_log_likelihood(mean, covariance, truth), -normal.log_prob(truth)
    )


def test_nll_of_a_rayleigh_error_is_the_papers():
    # A mean error of 2.9 px is sigma = 2.9 / sqrt(pi / 2) an axis; the paper prints 4.5 nats.
    sigma = 2.9 / (torch.pi / 2) ** 0.5
    truth = sigma * torch.randn(200_000, 2, generator=torch.Generator().manual_seed(0))
    covariance = (sigma**2 * torch.eye(2)).expand(200_000, 2, 2)
    nll = negative_log_likelihood(torch.zeros_like(truth), covariance, truth).mean()
    assert float(nll) == pytest.approx(4.52, abs=0.01)


def test_step_weights_halve_where_they_say_and_average_one():
    weights = step_weights(20, halving=4)
    assert float(weights.mean()) == pytest.approx(1)
    assert float(weights[4] / weights[0]) == pytest.approx(0.5)


def test_losses_are_least_at_the_truth():
    positions = torch.rand(2, 1, 5, 2) * 128
    at_truth = Observation(positions, None, None)
    assert DistanceLoss()(at_truth, positions) == pytest.approx(0, abs=1e-6)
    assert DistanceLoss()(Observation(positions + 3, None, None), positions) > 3

    covariances = torch.eye(2).expand(2, 1, 5, 2, 2)
    likelihood = LikelihoodLoss(halving=4)
    at_truth, off = (Observation(positions + by, covariances, None) for by in (0, 1))
    assert likelihood(off, positions) > likelihood(at_truth, positions)


@pytest.mark.parametrize(("regulariser", "likeliest"), [(0.0, 100.0), (0.01, 16.1)])
def test_the_regulariser_makes_large_variances_small(regulariser, likeliest):
    # Errors of variance v: the loss is least where 2 lambda l^3 + l = v (decision 0020).
    generator = torch.Generator().manual_seed(2)
    truth = 10 * torch.randn(20_000, 1, 1, 2, generator=generator)
    loss = LikelihoodLoss(halving=4, regulariser=regulariser, outlier=100)
    variances = torch.linspace(4, 120, 200)
    unit = torch.eye(2).expand(*truth.shape, 2)
    nowhere = torch.zeros_like(truth)
    losses = [loss(Observation(nowhere, size * unit, None), truth) for size in variances]
    assert float(variances[torch.stack(losses).argmin()]) == pytest.approx(likeliest, rel=0.05)


def test_angular_velocity_counts_where_there_is_one():
    positions, spins = torch.rand(2, 1, 5, 2), torch.randn(2, 1, 5, 3)
    loss = SpinLoss()
    assert loss(Observation(positions, None, spins), spins) == pytest.approx(0, abs=1e-6)
    assert loss(Observation(positions, None, spins + 5), spins) > 0.3
    assert loss(Observation(positions, None, None), spins) == 0
