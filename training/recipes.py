"""Experiments: named functions that return their complete configuration."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from rollcast.scene import SMALL_RADIUS_M, Scenario
from training.losses import DistanceLoss, LikelihoodLoss, Loss, SpinLoss
from training.models.compact import compact_family
from training.models.predictor import Family
from training.simulate import Source


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
    """When a share ``spent`` of the budget is gone, train on forecasts of ``horizon`` steps.

    Between milestones the horizon grows step by step: a jump from 10 to 20 destroyed a network
    that stood at 3 px (docs/experiments.md).
    """

    spent: float
    horizon: int


@dataclass(frozen=True)
class Member:
    """One of the networks that a recipe trains, and the name of its exported model."""

    name: str
    variant: str
    loss: Loss
    weight: float = 1.0
    """Of its loss among the members'."""


@dataclass(frozen=True)
class Recipe:
    """Everything that determines a training run.

    Attributes
    ----------
    members
        Networks that share encoder, transition and spin read-out, trained together.
    build
        Makes the untrained networks by name.
    sequences
        Budget.
    """

    name: str
    preset: str
    members: tuple[Member, ...]
    spin_loss: SpinLoss
    build: Callable[[], Family]
    data: tuple[DataShare, ...]
    scenarios: tuple[Scenario, ...]
    objects: int
    sequences: int
    curriculum: tuple[Milestone, ...]
    batch_size: int = 32
    learning_rate: float = 1e-3
    weight_decay: float = 0.01
    warm_up: float = 0.02
    """Share of the budget over which the learning rate rises; it then falls with a cosine."""
    gradient_clip: float = 1.0
    average_decay: float = 0.999
    """Of the exponential moving average of the weights, which is what gets evaluated."""
    validation_scenes: int = 100
    seed: int = 1

    @property
    def trained_horizon(self) -> int:
        """T_train."""
        return self.curriculum[-1].horizon

    def member(self, name: str) -> Member:
        """Return the member that is exported as ``name``."""
        return next(member for member in self.members if member.name == name)


ONE_BALL_DATA = (
    DataShare(Source("hemisphere"), 1200, 0.18, 200),
    DataShare(Source("ellipsoid"), 1800, 0.40, 200),
    DataShare(Source("heightfield"), 1200, 0.38, 120),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
)
"""Three scenarios at the usual radius, and a few small balls so that the eye knows them too.

Ellipsoids, of which the hemisphere is one, and heightfields are furthest from their aim.
"""


ONE_BALL = (
    Member("posnet", "posnet", DistanceLoss(halving=8)),
    Member("dispnet", "dispnet", DistanceLoss(halving=8), weight=0.5),
    Member("probnet", "probnet", LikelihoodLoss(halving=8)),
)
"""The rollout's early steps weigh more: a plain mean loses their precision."""


def one_ball() -> Recipe:
    """PosNet, DispNet and ProbNet for one ball in all scenarios, from nothing."""
    return Recipe(
        name="one-ball",
        preset="compact",
        members=ONE_BALL,
        spin_loss=SpinLoss(halving=8),
        build=lambda: compact_family(
            {member.name: member.variant for member in ONE_BALL}, 4, 1, angular_velocity=True
        ),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        objects=1,
        sequences=280_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.35, 10), Milestone(0.65, 20)),
    )


def one_ball_continued() -> Recipe:
    """Train the same from weights that already forecast (``--init``)."""
    return replace(
        one_ball(),
        name="one-ball-continued",
        sequences=240_000,
        curriculum=(Milestone(0, 20),),
        learning_rate=8e-4,
    )


RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "one-ball": one_ball,
    "one-ball-continued": one_ball_continued,
}
