"""Experiments: named functions that return their complete configuration."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from rollcast.scene import SMALL_RADIUS_M, Scenario
from training.losses import DistanceLoss, LikelihoodLoss, Loss
from training.models.posnet import compact_posnet
from training.models.predictor import Predictor
from training.models.probnet import compact_probnet
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
class Recipe:
    """Everything that determines a training run.

    Attributes
    ----------
    variant, preset
        Names for the manifest.
    build
        Makes the untrained network.
    sequences
        Budget.
    """

    name: str
    variant: str
    preset: str
    build: Callable[[], Predictor]
    loss: Loss
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


ONE_BALL_DATA = (
    DataShare(Source("hemisphere"), 1500, 0.25, 200),
    DataShare(Source("ellipsoid"), 1500, 0.30, 200),
    DataShare(Source("heightfield"), 1000, 0.37, 120),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 200, 0.04, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 200, 0.04, 200),
)
"""Three scenarios at the usual radius, and a few small balls so that the eye knows them too."""


def posnet() -> Recipe:
    """PosNet for one ball in all scenarios."""
    return Recipe(
        name="posnet",
        variant="posnet",
        preset="compact",
        build=lambda: compact_posnet(4, 1, angular_velocity=True),
        loss=DistanceLoss(),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        objects=1,
        sequences=280_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.35, 10), Milestone(0.65, 20)),
    )


def posnet_continued() -> Recipe:
    """PosNet again, from weights that already see and roll ten steps (``--init``)."""
    return replace(
        posnet(),
        sequences=150_000,
        curriculum=(Milestone(0.1, 10), Milestone(0.5, 20)),
        learning_rate=8e-4,
    )


def posnet_polished() -> Recipe:
    """PosNet's last stretch: the late steps, and the ellipsoid, which was furthest from its aim."""
    shares = (0.15, 0.50, 0.33, 0.01, 0.01)
    return replace(
        posnet(),
        loss=DistanceLoss(halving=10),
        data=tuple(
            replace(part, share=share) for part, share in zip(ONE_BALL_DATA, shares, strict=True)
        ),
        sequences=28_000,
        curriculum=(Milestone(0, 20),),
        learning_rate=4e-4,
        average_decay=0.995,
    )


def probnet() -> Recipe:
    """ProbNet for one ball in all scenarios, meant to start from PosNet's weights (``--init``)."""
    return Recipe(
        name="probnet",
        variant="probnet",
        preset="compact",
        build=lambda: compact_probnet(4, 1, angular_velocity=True),
        loss=LikelihoodLoss(spin=DistanceLoss(), halving=8.0),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        objects=1,
        sequences=14_000,
        curriculum=(Milestone(0.1, 10), Milestone(0.3, 20)),
        learning_rate=6e-4,
        average_decay=0.995,
    )


RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "posnet": posnet,
    "posnet-continued": posnet_continued,
    "posnet-polished": posnet_polished,
    "probnet": probnet,
}
