"""Teaches balls of a network for any number to meet, from true states alone.

Only what is told of others learns: a ball with nobody near moves as before, to the bit. Nothing is
rendered, so a batch costs little.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.data.ball_batch import BallBatch, collate
from training.data.ball_windows import BallSource
from training.networks.any_ball import AnyBallNet
from training.networks.fieldnet import MESSAGE, Ball, true_state
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Observation
from training.objectives.losses import MotionLoss, SpinLoss


@dataclass(frozen=True)
class EncounterTraining:
    """What such a training is determined by, besides its scenes.

    Attributes
    ----------
    batches
        Budget; the horizon grows to ``horizon`` over the first half of it.
    """

    batches: int
    batch_size: int = 64
    horizon: int = 24
    learning_rate: float = 1e-3
    halving: float = 8.0
    seed: int = 1


def train_encounters(
    network: AnyBallNet, sources: Sequence[BallSource], training: EncounterTraining
) -> Iterator[float]:
    """Train in place; yields the loss of every batch.

    Parameters
    ----------
    sources
        Scenes of several balls, as many in all of a source.
    """
    rolling = network.rolling
    assert rolling.encounters is not None
    columns = [rolling.layers[0].weight, rolling.linear.weight]
    learned = [*rolling.encounters.parameters(), *columns]
    optimiser = torch.optim.AdamW(learned, training.learning_rate, weight_decay=0.0)
    motion, spin = MotionLoss(training.halving), SpinLoss(training.halving)
    shares = np.array([source.share for source in sources])
    for number in range(training.batches):
        generator = np.random.default_rng([training.seed, number])
        source = sources[generator.choice(len(sources), p=shares / shares.sum())]
        windows = [
            source.maker.truth(generator, source.latest_start) for _ in range(training.batch_size)
        ]
        spent = number / training.batches
        horizon = int(np.interp(spent, (0, 0.5), (2, training.horizon)))
        for group in optimiser.param_groups:
            group["lr"] = training.learning_rate * 0.5 * (1 + np.cos(np.pi * spent))
        loss = _loss(network, collate(windows), horizon, motion, spin)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        for weight in columns:
            assert weight.grad is not None
            weight.grad[:, :-MESSAGE] = 0
        if torch.isfinite(torch.nn.utils.clip_grad_norm_(learned, 0.5)):
            optimiser.step()
        yield loss.item()


def _loss(
    network: AnyBallNet, batch: BallBatch, horizon: int, motion: MotionLoss, spin: SpinLoss
) -> torch.Tensor:
    # All windows of a batch have as many balls: none is padded.
    balls = int(batch.there[0].sum())
    centres, spins = batch.centres[:, :balls], batch.spins[:, :balls, :horizon]
    state = true_state(centres[:, :, :OBSERVED_FRAMES], spins[:, :, 0], batch.ground, batch.scene)
    ball = Ball.unpacked(state.p)
    moved, turned = [ball.centre], [ball.spin]
    for _ in range(horizon - 1):
        ball = network.rolling(ball, state.s)
        moved.append(ball.centre)
        turned.append(ball.spin)
    way, turning = torch.stack(moved, dim=2), ANGULAR_VELOCITY_UNIT * torch.stack(turned, dim=2)
    truth = centres[:, :, FIRST_FORECAST_FRAME : FIRST_FORECAST_FRAME + horizon]
    return motion(way, truth) + spin(Observation(way[..., :2], None, turning), spins)
