"""Losses over a rollout; the paper's and what the compact preset uses instead."""

from typing import Protocol

import torch
from torch import Tensor

from training.models.predictor import ANGULAR_VELOCITY_UNIT, Observation


class Loss(Protocol):
    """A scalar to minimise."""

    def __call__(
        self, forecast: Observation, positions_BNT2: Tensor, angular_velocities_BNT3: Tensor
    ) -> Tensor:
        """Loss of a forecast against the truth of the same steps."""
        ...


def step_weights(horizon: int, halving: float) -> Tensor:
    """Weights 1 / (1 + t / halving) with mean 1.

    A plain mean is ruled by the late steps' large errors and loses the precision of the early
    ones (docs/experiments.md).
    """
    weights = 1 / (1 + torch.arange(horizon) / halving)
    return weights / weights.mean()


class DistanceLoss:
    """Weighted mean distance in pixels, rounded off within ``rounding`` px, plus spin's.

    Parameters
    ----------
    halving
        Step at which the weight is half of the first's.
    spin_weight
        Pixels that an angular velocity error of 1 rad/s counts for; errors count relative to the
        speed itself beyond 20 rad/s, where small balls spin.
    """

    def __init__(self, halving: float = 4.0, spin_weight: float = 0.3, rounding: float = 0.5):
        self._halving = halving
        self._spin_weight = spin_weight
        self._rounding = rounding

    def __call__(
        self, forecast: Observation, positions_BNT2: Tensor, angular_velocities_BNT3: Tensor
    ) -> Tensor:
        """Loss of a forecast against the truth of the same steps."""
        weights = step_weights(positions_BNT2.shape[2], self._halving)
        weights = weights.to(positions_BNT2.device)
        loss = (weights * self.distance(forecast.positions - positions_BNT2)).mean()
        return loss + self.spin(forecast, angular_velocities_BNT3, weights)

    def distance(self, difference: Tensor) -> Tensor:
        """Euclidean distance, smooth at zero."""
        return (difference.square().sum(-1) + self._rounding**2).sqrt() - self._rounding

    def spin(self, forecast: Observation, truth_BNT3: Tensor, weights_T: Tensor) -> Tensor:
        """Angular velocity's share of the loss; zero when the network has none."""
        if forecast.angular_velocities is None:
            return torch.zeros((), device=truth_BNT3.device)
        scale = 1 + truth_BNT3.norm(dim=-1) / ANGULAR_VELOCITY_UNIT
        error = self.distance(forecast.angular_velocities - truth_BNT3) / scale
        return self._spin_weight * (weights_T * error).mean()


class LikelihoodLoss:
    """Negative log likelihood with the paper's regulariser lambda det(Sigma), plus spin's loss.

    Paper, sections 3.3 and 5.2; lambda = 0.01.
    """

    def __init__(self, spin: DistanceLoss, halving: float, regulariser: float = 0.01) -> None:
        self._spin = spin
        self._halving = halving
        self._regulariser = regulariser

    def __call__(
        self, forecast: Observation, positions_BNT2: Tensor, angular_velocities_BNT3: Tensor
    ) -> Tensor:
        """Loss of a forecast, which has covariances, against the truth of the same steps."""
        assert forecast.covariances is not None
        weights = step_weights(positions_BNT2.shape[2], self._halving)
        weights = weights.to(positions_BNT2.device)
        nll = negative_log_likelihood(forecast.positions, forecast.covariances, positions_BNT2)
        penalty = self._regulariser * determinant(forecast.covariances)
        spin = self._spin.spin(forecast, angular_velocities_BNT3, weights)
        return (weights * (nll + penalty)).mean() + spin


def negative_log_likelihood(positions: Tensor, covariances: Tensor, truth: Tensor) -> Tensor:
    """-log N(truth; positions, covariances) in nats, over the last axes [2] and [2, 2]."""
    dx, dy = (truth - positions).unbind(-1)
    det = determinant(covariances)
    xx, xy, yy = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    mahalanobis = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / det
    return 0.5 * (mahalanobis + det.log()) + torch.log(torch.tensor(2 * torch.pi))


def determinant(covariances: Tensor) -> Tensor:
    """Return the determinants of 2 x 2 matrices."""
    return covariances[..., 0, 0] * covariances[..., 1, 1] - covariances[..., 0, 1].square()
