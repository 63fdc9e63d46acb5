"""Losses over a rollout; the paper's and what the compact preset uses instead.

The loss of a network is that of its positions plus that of its angular velocities (paper, section
5.1).
"""

from typing import Protocol

import torch
from torch import Tensor

from training.models.predictor import ANGULAR_VELOCITY_UNIT, Observation


class Loss(Protocol):
    """A scalar to minimise: how far a forecast's positions are from the truth of its steps."""

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast."""
        ...


def step_weights(horizon: int, halving: float) -> Tensor:
    """Weights 1 / (1 + t / halving) with mean 1.

    A plain mean is ruled by the late steps' large errors and loses the precision of the early
    ones (docs/experiments.md).
    """
    weights = 1 / (1 + torch.arange(horizon) / halving)
    return weights / weights.mean()


class DistanceLoss:
    """Weighted mean distance in pixels, rounded off within ``rounding`` px.

    Parameters
    ----------
    halving
        Step at which the weight is half of the first's.
    """

    def __init__(self, halving: float = 4.0, rounding: float = 0.5) -> None:
        self._halving = halving
        self._rounding = rounding

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast in pixels."""
        weights = step_weights(positions_BNT2.shape[2], self._halving)
        error = smooth_distance(forecast.positions - positions_BNT2, self._rounding)
        return (weights.to(error.device) * error).mean()


class LikelihoodLoss:
    """Negative log likelihood with the paper's regulariser lambda det(Sigma).

    Paper, sections 3.3 and 5.2; lambda = 0.01.
    """

    def __init__(self, halving: float, regulariser: float = 0.01) -> None:
        self._halving = halving
        self._regulariser = regulariser

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast, which has covariances, in nats."""
        assert forecast.covariances is not None
        weights = step_weights(positions_BNT2.shape[2], self._halving)
        nll = negative_log_likelihood(forecast.positions, forecast.covariances, positions_BNT2)
        penalty = self._regulariser * determinant(forecast.covariances)
        return (weights.to(nll.device) * (nll + penalty)).mean()


class SpinLoss:
    """Weighted mean angular velocity error; zero for a network without angular velocity.

    Parameters
    ----------
    halving
        Step at which the weight is half of the first's.
    weight
        Pixels that an error of 1 rad/s counts for; errors count relative to the speed itself
        beyond 20 rad/s, where small balls spin.
    """

    def __init__(self, halving: float = 4.0, weight: float = 0.3, rounding: float = 0.5) -> None:
        self._halving = halving
        self._weight = weight
        self._rounding = rounding

    def __call__(self, forecast: Observation, angular_velocities_BNT3: Tensor) -> Tensor:
        """Loss of a forecast in pixels."""
        truth = angular_velocities_BNT3
        if forecast.angular_velocities is None:
            return torch.zeros((), device=truth.device)
        weights = step_weights(truth.shape[2], self._halving).to(truth.device)
        scale = 1 + truth.norm(dim=-1) / ANGULAR_VELOCITY_UNIT
        error = smooth_distance(forecast.angular_velocities - truth, self._rounding) / scale
        return self._weight * (weights * error).mean()


def smooth_distance(difference: Tensor, rounding: float) -> Tensor:
    """Euclidean distance over the last axis, smooth at zero."""
    return (difference.square().sum(-1) + rounding**2).sqrt() - rounding


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
