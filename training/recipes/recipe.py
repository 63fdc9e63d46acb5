"""Configuration of a training run."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from rollcast.scene import Scenario
from training.data.appearance_mixture import AppearanceMixture
from training.data.shards import Source
from training.networks.presets import PRESETS
from training.networks.recurrent import Family
from training.networks.task import Task
from training.objectives.losses import Loss, MotionLoss, PerceptionLoss, SpinLoss
from training.objectives.schedules import Cosine, Schedule


@dataclass(frozen=True)
class DataShare:
    """A source of training scenes.

    Attributes
    ----------
    scenes
        Simulated scenes of the training split.
    share
        Part of every batch, relative to the other sources'.
    latest_start
        Last frame of a simulation at which a training window may begin.
    """

    source: Source
    scenes: int
    share: float
    latest_start: int


@dataclass(frozen=True)
class Milestone:
    """Horizon of the training once a share ``progress`` of the budget is used.

    Between milestones the horizon grows step by step: a jump from 10 to 20 destroyed a network
    that stood at 3 px (docs/experiments.md).
    """

    progress: float
    horizon: int


def adamw(groups: Iterable[dict[str, Any]], rate: float) -> torch.optim.Optimizer:
    """Make AdamW; its second moment has to follow gradients that grow with the horizon."""
    return torch.optim.AdamW(groups, rate, betas=(0.9, 0.95), weight_decay=0.01)


@dataclass(frozen=True)
class Member:
    """One of the networks that a recipe trains, and the name of its exported model."""

    name: str
    variant: str
    loss: Loss
    weight: float = 1.0
    """Weight of its loss among the members' losses."""


@dataclass(frozen=True)
class Explicit:
    """Supervision of an explicit state, in addition to forecasts.

    Attributes
    ----------
    perception
        Loss of the perception outputs; None for frozen perception.
    motion
        Loss of balls that are moved from their true states over the true ground, so that motion is
        trained before the perception is accurate; None uses the loss of forecasts.
    true_state_windows
        Number of windows from true states per batch; they need no rendering.
    curriculum
        Horizons of the windows from true states.
    motion_rate
        Learning rate of the motion, relative to all other parts. The rate for perception would
        destabilise trained motion.
    """

    perception: PerceptionLoss | None
    motion: MotionLoss | None
    true_state_windows: int
    curriculum: tuple[Milestone, ...]
    motion_rate: float = 1.0


@dataclass(frozen=True)
class Recipe:
    """Everything that determines a training run.

    Attributes
    ----------
    preset
        Name in PRESETS.
    members
        Networks that share encoder, transition and spin read-out, trained together.
    sequences
        Budget.
    """

    name: str
    preset: str
    members: tuple[Member, ...]
    spin_loss: SpinLoss
    data: tuple[DataShare, ...]
    scenarios: tuple[Scenario, ...]
    task: Task
    sequences: int
    curriculum: tuple[Milestone, ...]
    batch_size: int = 32
    learning_rate: float = 1e-3
    optimiser: Callable[[Iterable[dict[str, Any]], float], torch.optim.Optimizer] = adamw
    schedule: Callable[[], Schedule] = Cosine
    heads_alone: float = 0.0
    """Share of the budget in which only the heads are trained, to protect shared parts."""
    gradient_clip: float = 2.0
    """Maximum gradient norm, in multiples of the usual norm."""
    average_decay: float = 0.999
    """Decay of the exponential moving average of the weights, which is evaluated."""
    frozen: tuple[str, ...] = ()
    """Prefixes of the names of frozen parameters."""
    replay_windows: int = 0
    """Number of windows whose perception outputs are cached for reuse in batches; with 0, every
    batch is rendered and processed."""
    validation_scenes: int = 100
    seed: int = 1

    explicit: Explicit | None = None
    """Supervision of networks with an explicit state."""

    earlier_horizon: int = 0
    """Horizon of the training of the ``frozen`` parts."""

    appearances: AppearanceMixture | None = None
    """Appearances of training windows; None for the paper's only."""

    def build(self) -> Family:
        """Create the untrained networks."""
        variants = {member.name: member.variant for member in self.members}
        return PRESETS[self.preset](variants, self.task)

    @property
    def trained_horizon(self) -> int:
        """T_train."""
        return self.curriculum[-1].horizon

    def member(self, name: str) -> Member:
        """Return the member that is exported as ``name``."""
        return next(member for member in self.members if member.name == name)


def continued(recipe: Recipe) -> Recipe:
    """Return a recipe that continues the training of weights.

    A convolutional state keeps its last horizon. An explicit state starts with perception only,
    because gradients through rollouts on heightfields are heavy-tailed and expensive.
    """
    longest = recipe.trained_horizon
    explicit = recipe.explicit
    if explicit is None or explicit.perception is None:
        whole = (Milestone(0, longest),)
        if explicit is not None:
            explicit = replace(explicit, curriculum=whole)
        return replace(recipe, curriculum=whole, explicit=explicit)
    return replace(
        recipe,
        curriculum=(Milestone(0.7, 1), Milestone(0.75, longest // 2), Milestone(0.88, longest)),
        explicit=replace(
            explicit,
            true_state_windows=64,
            curriculum=(Milestone(0, longest // 2),),
            motion_rate=0.1,
        ),
    )


def horizon_at(curriculum: tuple[Milestone, ...], progress: float) -> int:
    """Return the training horizon once a share ``progress`` of the budget is used."""
    shares = [milestone.progress for milestone in curriculum]
    horizons = [milestone.horizon for milestone in curriculum]
    return int(np.interp(progress, shares, horizons))


def longest_rollout(recipe: Recipe, progress: float) -> int:
    """Return the longest rollout used in training once a share ``progress`` is used.

    Rollouts start from frames or from true states. This is the trained horizon of weights that
        are saved before the end of the training.
    """
    horizon = max(horizon_at(recipe.curriculum, progress), recipe.earlier_horizon)
    if recipe.explicit is None:
        return horizon
    return max(horizon, horizon_at(recipe.explicit.curriculum, progress))
