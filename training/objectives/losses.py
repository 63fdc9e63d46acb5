"""Losses over a rollout: those of the paper and of the compact preset.

The loss of a network is that of its positions plus that of its angular velocities (paper, section
5.1). True values that are NaN are unknown and have no loss.
"""

import math
from typing import Protocol

import torch
from torch import Tensor

from rollcast.trajectory import OBSERVED_FRAMES
from training.networks.blocks import PIXEL_UNIT
from training.networks.perception import PATCH_HALF_WIDTH, ZOOM_MARGIN, sampled
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Observation, PerceptionOutput


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
        error = smooth_distance(
            known_difference(forecast.positions, positions_BNT2), self._rounding
        )
        return (weights.to(error.device) * error).mean()


class SquaredLoss:
    """Mean squared distance in px^2 (paper, section 3.3)."""

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast in px^2."""
        return (forecast.positions - positions_BNT2).square().sum(-1).mean()


class LikelihoodLoss:
    """Negative log likelihood with the paper's regulariser lambda det(Sigma).

    Paper, sections 3.3 and 5.2; lambda = 0.01. Beyond ``outlier`` standard deviations it grows
    linearly: one forecast that is far off and sure of itself would otherwise outweigh its whole
    batch (docs/experiments.md).
    """

    def __init__(self, halving: float, regulariser: float = 0.01, outlier: float = 3.0) -> None:
        self._halving = halving
        self._regulariser = regulariser
        self._outlier = outlier

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast, which has covariances, in nats up to a constant."""
        assert forecast.covariances is not None
        weights = step_weights(positions_BNT2.shape[2], self._halving)
        known = ~positions_BNT2.isnan().any(dim=-1)
        truth = torch.where(positions_BNT2.isnan(), forecast.positions.detach(), positions_BNT2)
        squared = mahalanobis(forecast.positions, forecast.covariances, truth)
        limit = self._outlier
        linear = 2 * limit * squared.clamp(min=limit**2).sqrt() - limit**2
        bounded = torch.where(squared < limit**2, squared, linear)
        nll = 0.5 * (bounded + determinant(forecast.covariances).log())
        penalty = self._regulariser * determinant(forecast.covariances)
        return (weights.to(nll.device) * known * (nll + penalty)).mean()


class SpinLoss:
    """Weighted mean angular velocity error; zero for a network without angular velocity.

    Parameters
    ----------
    halving
        Step at which the weight is half of the first's.
    weight
        Pixels that an error of 1 rad/s counts for; errors count relative to the speed itself
        beyond 20 rad/s, where small balls spin.
    squared
        Plain squared errors instead, as in the paper.
    """

    def __init__(
        self,
        halving: float = 4.0,
        weight: float = 0.3,
        rounding: float = 0.5,
        *,
        squared: bool = False,
    ) -> None:
        self._halving = halving
        self._weight = weight
        self._rounding = rounding
        self._squared = squared

    def __call__(self, forecast: Observation, angular_velocities_BNT3: Tensor) -> Tensor:
        """Loss of a forecast in pixels."""
        truth = angular_velocities_BNT3
        if forecast.angular_velocities is None:
            return torch.zeros((), device=truth.device)
        weights = step_weights(truth.shape[2], self._halving).to(truth.device)
        if self._squared:
            error = (forecast.angular_velocities - truth).square().sum(-1)
            return self._weight * (weights * error).mean()
        scale = 1 + truth.nan_to_num().norm(dim=-1) / ANGULAR_VELOCITY_UNIT
        off = known_difference(forecast.angular_velocities, truth)
        error = smooth_distance(off, self._rounding) / scale
        return self._weight * (weights * error).mean()


class DetachedNllLoss:
    """Distances for the positions, likelihood for the covariances alone.

    The likelihood takes the positions as they are, so uncertainty costs them nothing.
    """

    def __init__(self, positions: Loss, likelihood: Loss, weight: float) -> None:
        self._positions = positions
        self._likelihood = likelihood
        self._weight = weight

    def __call__(self, forecast: Observation, positions_BNT2: Tensor) -> Tensor:
        """Loss of a forecast in pixels, and nats times the weight."""
        settled = forecast._replace(positions=forecast.positions.detach())
        likelihood = self._weight * self._likelihood(settled, positions_BNT2)
        return self._positions(forecast, positions_BNT2) + likelihood


class PerceptionLoss:
    """Loss of perception outputs in pixels, weighted by their effect on forecasts.

    Refined passes have larger weights than the coarse one, velocities the largest, because their
    errors grow with every step. True values that are NaN have no loss: footage has positions only.

    Parameters
    ----------
    within_reach
        Whether a refined pass has a loss only if the previous pass left the ball in its patch:
        outputs of patches without a ball are noise.
    """

    passes = (0.3, 0.5, 1.5, 1.5)
    """Weights of the coarse pass, the refined passes and, if present, the zoomed pass."""
    displacement = 1.5
    """Weight of displacements between observed frames in the last pass, which errors common to all
    frames do not affect."""
    radius = 2.0
    height = 0.5
    velocity = 3.0
    ground = 15.0
    way = 30.0
    scene_constants = 2.0
    rounding = 0.1

    def __init__(self, *, within_reach: bool = False) -> None:
        self._within_reach = within_reach

    def __call__(
        self,
        perceived: PerceptionOutput,
        scene_targets: tuple[Tensor, Tensor, Tensor],
        shake_BK2: Tensor | None = None,
        radii_BN: Tensor | None = None,
    ) -> Tensor:
        """Loss against the fields of :class:`training.data.windows.SceneTargets`.

        Parameters
        ----------
        shake_BK2
            Shift of the picture in the observed frames, halves of the frame: it moves the image,
            not the ball.
        radii_BN
            Of the balls in the picture, halves of the frame.
        """
        centres, ground, scene_constants = scene_targets
        seen, now = centres[:, :, :OBSERVED_FRAMES, :2], centres[:, :, OBSERVED_FRAMES - 1]
        if shake_BK2 is not None:
            seen = seen + shake_BK2[:, None]
        before = centres[:, :, OBSERVED_FRAMES - 2]
        masks = self._pass_masks(perceived, seen)
        found = masks[-1].amin(dim=2)
        off = known_difference(perceived.centres, now)
        loss = self._pixels(off[..., :2], found)
        loss = loss + self.height * PIXEL_UNIT * (found * off[..., 2].abs()).mean()
        passes = zip(self.passes, perceived.seen_positions, masks, strict=False)
        for weight, positions, share in passes:
            loss = loss + weight * self._pixels(positions - seen, share)
        moved = perceived.seen_positions[-1].diff(dim=2) - seen.diff(dim=2)
        loss = loss + self.displacement * self._pixels(moved, found[..., None])
        if perceived.radii is not None and radii_BN is not None:
            unlike = known_difference(perceived.radii.log(), radii_BN.log())
            loss = loss + self.radius * (found * unlike.abs()).mean()
        off = known_difference(perceived.velocities, now - before)
        loss = loss + self.velocity * self._pixels(off, found)
        unlike = known_difference(perceived.ground, ground).abs()
        loss = loss + self.ground * unlike.sum(dim=1).mean()
        loss = loss + self.way * self._along_the_way(perceived.ground, ground, centres)
        return (
            loss
            + self.scene_constants
            * known_difference(perceived.scene_constants, scene_constants).abs().mean()
        )

    def _along_the_way(self, read: Tensor, ground: Tensor, centres: Tensor) -> Tensor:
        """Mean error of the ground where the balls will be: more than elsewhere depends on it."""
        known = (~ground.isnan()).float()
        points = centres[..., :2].nan_to_num()
        unlike = sampled(read, points) - sampled(ground.nan_to_num(), points)
        return (unlike.abs() * (sampled(known, points) > 0.999)).sum(dim=-1).mean()

    def _pass_masks(self, perceived: PerceptionOutput, seen: Tensor) -> list[Tensor]:
        """Return, for every pass, where it is evaluated: 1 or 0 [B, N, K]."""
        passes = [positions.detach() for positions in perceived.seen_positions]
        everywhere = torch.ones_like(passes[0][..., 0])
        if not self._within_reach:
            return [everywhere] * len(passes)
        off = [(positions - seen).abs().amax(dim=-1) for positions in passes]
        masks = [everywhere, *((before < PATCH_HALF_WIDTH).float() for before in off[:2])]
        if len(passes) > len(masks):
            assert perceived.radii is not None
            reach = perceived.radii.detach()[..., None] + ZOOM_MARGIN
            masks.append(masks[-1] * (off[2] < reach))
        return masks

    def _pixels(self, difference: Tensor, share: Tensor | None = None) -> Tensor:
        distance = smooth_distance(PIXEL_UNIT * difference, self.rounding)
        return (distance if share is None else share * distance).mean()


class MotionLoss:
    """Balls moved from their true states: centres in pixels, and how they move.

    Parameters
    ----------
    halving
        Step at which the weight is half of the first's.
    """

    rounding = 0.1

    def __init__(self, halving: float) -> None:
        self._halving = halving

    def __call__(self, centres_BNT3: Tensor, truth_BNT3: Tensor) -> Tensor:
        """Loss of rolled-out centres, halves of the frame; unknown ones (NaN) cost nothing."""
        weights = step_weights(truth_BNT3.shape[2], self._halving).to(truth_BNT3.device)
        off = PIXEL_UNIT * known_difference(centres_BNT3, truth_BNT3)
        moved = (off[:, :, 1:] - off[:, :, :-1]).norm(dim=-1)
        return (weights * smooth_distance(off, self.rounding)).mean() + moved.mean()


def final_loss(forecast: Observation, final_positions_BN2: Tensor) -> Tensor:
    """Mean distance in pixels between the final positions in h_0 and the true ones."""
    assert forecast.final_positions is not None
    return smooth_distance(forecast.final_positions - final_positions_BN2, 0.5).mean()


def known_difference(read: Tensor, truth: Tensor) -> Tensor:
    """Difference from the truth, zero where that is not known (NaN)."""
    return torch.where(truth.isnan(), 0.0, read - truth.nan_to_num())


def smooth_distance(difference: Tensor, rounding: float) -> Tensor:
    """Euclidean distance over the last axis, smooth at zero."""
    return (difference.square().sum(-1) + rounding**2).sqrt() - rounding


def negative_log_likelihood(positions: Tensor, covariances: Tensor, truth: Tensor) -> Tensor:
    """-log N(truth; positions, covariances) in nats, over the last axes [2] and [2, 2]."""
    squared = mahalanobis(positions, covariances, truth)
    return 0.5 * (squared + determinant(covariances).log()) + math.log(2 * math.pi)


def mahalanobis(positions: Tensor, covariances: Tensor, truth: Tensor) -> Tensor:
    """Return squared Mahalanobis distances over the last axes [2] and [2, 2]."""
    dx, dy = (truth - positions).unbind(-1)
    xx, xy, yy = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    return (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant(covariances)


def determinant(covariances: Tensor) -> Tensor:
    """Return the determinants of 2 x 2 matrices."""
    return covariances[..., 0, 0] * covariances[..., 1, 1] - covariances[..., 0, 1].square()
