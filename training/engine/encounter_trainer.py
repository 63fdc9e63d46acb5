"""Training of the interactions between balls in :class:`AnyBallNet`, on true states.

Only the messages between balls, and the weights that read them, are trained: the motion of a ball
without neighbours stays the same to the bit. No frames are rendered, so batches are cheap.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.data.ball_batch import BallBatch, collate
from training.data.ball_windows import BallSource
from training.engine.cosine_descent import cosine_descent
from training.networks.any_ball import AnyBallNet
from training.networks.fieldnet import MESSAGE, true_state
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Observation
from training.objectives.losses import MotionLoss, SpinLoss


@dataclass(frozen=True)
class EncounterTraining:
    """Configuration of a training of interactions, without its scenes.

    Attributes
    ----------
    batches
        Number of batches.
    batch_size
        Windows per batch.
    horizon
        Steps of the longest rollouts; the horizon grows from 2 over the first half of the batches.
    learning_rate
        Initial learning rate; it falls to 0 along half a cosine.
    halving
        Step at which an error has half the weight of the first one in the losses.
    seed
        Seed of the windows.
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
    """Train ``network`` in place and yield the loss of every batch.

    Parameters
    ----------
    network
        Network with ``pair_interaction``.
    sources
        Scenes of several balls. All scenes of one source have the same number of balls.
    training
        Configuration.
    """
    rolling = network.rolling
    assert rolling.pair_interaction is not None
    columns = [rolling.layers[0].weight, rolling.linear.weight]
    trained = [*rolling.pair_interaction.parameters(), *columns]
    motion, spin = MotionLoss(training.halving), SpinLoss(training.halving)
    shares = np.array([source.share for source in sources])

    def loss_at(generator: np.random.Generator, progress: float) -> torch.Tensor:
        source = sources[generator.choice(len(sources), p=shares / shares.sum())]
        windows = [
            source.maker.truth(generator, source.latest_start) for _ in range(training.batch_size)
        ]
        horizon = int(np.interp(progress, (0, 0.5), (2, training.horizon)))
        return _loss(network, collate(windows), horizon, motion, spin)

    def mask_gradients() -> None:
        # The last columns read the messages; all others stay.
        for weight in columns:
            assert weight.grad is not None
            weight.grad[:, :-MESSAGE] = 0

    yield from cosine_descent(
        loss_at,
        [{"params": trained, "lr": training.learning_rate}],
        batches=training.batches,
        weight_decay=0.0,
        seed=training.seed,
        mask_gradients=mask_gradients,
    )


def _loss(
    network: AnyBallNet, batch: BallBatch, horizon: int, motion: MotionLoss, spin: SpinLoss
) -> torch.Tensor:
    # All windows of a batch have the same number of balls, so no slot is padding.
    balls = int(batch.there[0].sum())
    centres, spins = batch.centres[:, :balls], batch.spins[:, :balls, :horizon]
    state = true_state(centres[:, :, :OBSERVED_FRAMES], spins[:, :, 0], batch.ground, batch.scene)
    steps = network.rolling.trajectory(state, horizon)
    paths = torch.stack([step.centre for step in steps], dim=2)
    velocities = ANGULAR_VELOCITY_UNIT * torch.stack([step.spin for step in steps], dim=2)
    truth = centres[:, :, FIRST_FORECAST_FRAME : FIRST_FORECAST_FRAME + horizon]
    return motion(paths, truth) + spin(Observation(paths[..., :2], None, velocities), spins)
