"""Training of the initial state and of the motion of :class:`AnyBallNet` on whole trajectories.

The perception is frozen, and its outputs are computed once per window. A loss at t = 0 weights all
errors of a velocity alike; a loss along the trajectory weights them by their effect on it, and the
motion is trained on states as the perception measures them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.data.ball_batch import BallBatch
from training.engine.ball_trainer import VISIBLE
from training.engine.cosine_descent import cosine_descent
from training.networks.any_ball import AnyBallNet, Seen, seen_balls
from training.networks.ball_detector import PIXEL, BallMaps, voted
from training.networks.blocks import PIXEL_UNIT
from training.networks.patches import half_widths
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Observation
from training.objectives.losses import (
    LikelihoodLoss,
    MotionLoss,
    SpinLoss,
    known_difference,
    smooth_distance,
)

MOST_BALLS = 3
"""Balls of a window at most: as many as the simulations have."""
MOTION_PARTS = ("perception.state.", "rolling.", "first_covariance.", "covariance_from_sigmas.")
"""Prefixes of the parameters that are trained."""
LIKELIHOOD_WEIGHT = 0.2
"""Pixels that a nat counts for; the likelihood trains the covariances alone."""


class BallPerceptionOutputs(NamedTuple):
    """Outputs of the perception for W windows of N balls, with their true states."""

    places: Tensor
    """Positions [W, N, K, 2] in the observed frames."""
    radii: Tensor
    """Radii [W, N]."""
    visible: Tensor
    """Logits [W, N, K] of visibility."""
    log_sigmas: Tensor
    """Logarithms [W, N, 2] of the standard deviations."""
    features: Tensor
    """Features [W, N, FEATURES] of the refiner."""
    ground: Tensor
    """Ground maps [W, 3, G, G]."""
    scene: Tensor
    """Scene constants [W, 2]."""
    spacing: Tensor
    """Time [W] between two observed frames, in steps of the forecast."""
    centres: Tensor
    """True centres [W, N, S, 3] from t = -3 on, one step apart; unknown ones are NaN."""
    spins: Tensor
    """True angular velocities [W, N, T, 3] in rad/s from t = 0 on; unknown ones are NaN."""

    @property
    def seen(self) -> Seen:
        """Outputs of the perception for the balls."""
        return seen_balls(self.places, self.radii, self.visible, self.log_sigmas, self.features)

    def taken(self, index: Tensor) -> "BallPerceptionOutputs":
        """Return the outputs of some windows."""
        return BallPerceptionOutputs(*(part[index] for part in self))


@dataclass(frozen=True)
class MotionTraining:
    """Configuration of a training, besides its cached perception outputs.

    Attributes
    ----------
    batches
        Budget; the horizon grows to ``horizon`` over the first half of it.
    state_rate, motion_rate
        Learning rates of the states at t = 0 and of the motion; both fall to zero as a cosine.
    """

    batches: int
    batch_size: int = 128
    horizon: int = 40
    state_rate: float = 8e-4
    motion_rate: float = 5e-5
    halving: float = 10.0
    seed: int = 1


def read_windows(
    network: AnyBallNet, batches: Iterable[BallBatch], seed: int
) -> Mapping[int, BallPerceptionOutputs]:
    """Return the perception outputs of some batches, by their number of balls.

    Balls are read as if a point on each were given: the detector says where patches begin.
    """
    generator = torch.Generator().manual_seed(seed)
    rows: dict[int, list[BallPerceptionOutputs]] = {}
    for batch in batches:
        with torch.inference_mode():
            maps = network.perception.detector.maps(batch.frames)
            for window in range(len(batch.frames)):
                balls = _balls_of(batch, window)
                if not 0 < len(balls) <= MOST_BALLS:
                    continue
                places, radii = batch.places[window, balls], batch.radii[window, balls]
                off = torch.rand(places[:, -1].shape, generator=generator) - 0.5
                click = places[:, -1] + off * torch.maximum(radii, 3 * PIXEL * radii**0)[:, None]
                one = slice(window, window + 1)
                said = voted(BallMaps(*(part[one] for part in maps)), click[None])
                lost = (said.places[0] - places).norm(dim=-1).amax(dim=-1) > 0.8 * half_widths(
                    radii
                )
                if lost.any():
                    continue
                seen = network.perception.refine(batch.frames[one], said.places, said.radii)
                perceived = BallPerceptionOutputs(
                    seen.places, seen.radii, seen.visible, seen.log_sigmas, seen.features,
                    maps.ground[one], maps.scene[one], batch.spacing[one],
                    batch.centres[one, balls], batch.spins[one, balls],
                )  # fmt: skip
                rows.setdefault(len(balls), []).append(
                    BallPerceptionOutputs(*(part.clone() for part in perceived))
                )
    return {
        count: BallPerceptionOutputs(*(torch.cat(parts) for parts in zip(*outputs, strict=True)))
        for count, outputs in sorted(rows.items())
    }


def _balls_of(batch: BallBatch, window: int) -> Tensor:
    """Index of the balls of a window to read: those whose future is known, or else any two."""
    visible = batch.visible[window, :, -1].nan_to_num() > VISIBLE
    known = ~batch.centres[window, :, :, :2].isnan().flatten(1).any(dim=1)
    if known.any():
        return known.nonzero()[:, 0] if visible[known].all() else known.new_zeros(0).long()
    return (visible & (batch.there[window] > 0)).nonzero()[:2, 0]


def train_motion(
    network: AnyBallNet, outputs: Mapping[int, BallPerceptionOutputs], training: MotionTraining
) -> Iterator[float]:
    """Train in place; yield the loss of every batch.

    Parameters
    ----------
    outputs
        By number of balls.
    """
    motion, states = [], []
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(MOTION_PARTS))
        if name.startswith("rolling."):
            motion.append(parameter)
        elif parameter.requires_grad:
            states.append(parameter)
    counts = list(outputs)
    shares = np.array([len(outputs[count].radii) for count in counts], float)

    def loss_at(generator: np.random.Generator, progress: float) -> Tensor:
        some = outputs[counts[generator.choice(len(counts), p=shares / shares.sum())]]
        index = torch.from_numpy(generator.integers(len(some.radii), size=training.batch_size))
        horizon = int(np.interp(progress, (0, 0.5), (4, training.horizon)))
        return trajectory_loss(network, some.taken(index), horizon, training.halving)

    yield from cosine_descent(
        loss_at,
        [
            {"params": states, "lr": training.state_rate},
            {"params": motion, "lr": training.motion_rate},
        ],
        batches=training.batches,
        weight_decay=1e-3,
        seed=training.seed,
    )


def trajectory_loss(
    network: AnyBallNet, outputs: BallPerceptionOutputs, horizon: int, halving: float
) -> Tensor:
    """Loss in pixels of trajectories from the outputs of the perception; NaN has no loss."""
    seen = outputs.seen
    state, balls = network.begin(seen, outputs.ground, outputs.scene, outputs.spacing)
    steps = network.rolling.trajectory(state, horizon)
    centres = torch.stack([step.centre for step in steps], dim=2)
    truth = outputs.centres[:, :, FIRST_FORECAST_FRAME : FIRST_FORECAST_FRAME + horizon]
    loss = MotionLoss(halving)(centres, truth)
    covariance_params = torch.stack([step.covariance_params for step in steps], dim=2)
    flat = torch.cat([centres[..., :2].detach(), covariance_params], dim=-1)
    positions, covariances = network.output(flat)
    spins = ANGULAR_VELOCITY_UNIT * torch.stack([step.spin for step in steps], dim=2)
    made = Observation(positions, covariances, spins)
    pixels = PIXEL_UNIT * (1 + truth[..., :2])
    loss = loss + LIKELIHOOD_WEIGHT * LikelihoodLoss(halving, 0.0, 5.0)(made, pixels)
    loss = loss + SpinLoss(halving)(made, outputs.spins[:, :, :horizon])
    now, before = (outputs.centres[:, :, OBSERVED_FRAMES - 1 - back] for back in (0, 1))
    for said, true in ((balls.centres, now), (balls.velocities, now - before)):
        off = PIXEL_UNIT * known_difference(said, true)
        loss = loss + smooth_distance(off, MotionLoss.rounding).mean()
    return loss
