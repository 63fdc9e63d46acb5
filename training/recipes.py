"""Experiments: named functions that return their complete configuration."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
class Stage:
    """Until ``until`` of the budget is spent, train on forecasts of ``horizon`` steps."""

    until: float
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
    warm_start
        Parameters to take over from an exported model, by prefix.
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
    curriculum: tuple[Stage, ...]
    batch_size: int = 32
    learning_rate: float = 1.5e-3
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
        sequences=250_000,
        curriculum=(Stage(0.12, 2), Stage(0.5, 10), Stage(1.0, 20)),
    )


def probnet() -> Recipe:
    """ProbNet for one ball in all scenarios."""
    return Recipe(
        name="probnet",
        variant="probnet",
        preset="compact",
        build=lambda: compact_probnet(4, 1, angular_velocity=True),
        loss=LikelihoodLoss(spin=DistanceLoss(), halving=8.0),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        objects=1,
        sequences=60_000,
        curriculum=(Stage(0.1, 8), Stage(1.0, 20)),
    )


RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "posnet": posnet,
    "probnet": probnet,
}
