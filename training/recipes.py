"""Experiments: named functions that return their complete configuration."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import torch

from rollcast.scene import SMALL_RADIUS_M, Scenario
from training.losses import (
    DistanceLoss,
    DoubtLoss,
    LikelihoodLoss,
    Loss,
    MotionLoss,
    ReadingLoss,
    SpinLoss,
    SquaredLoss,
)
from training.models.predictor import Family
from training.models.presets import PRESETS
from training.schedules import Cosine, Plateau, Schedule
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
    """Of its loss among the members'."""


@dataclass(frozen=True)
class Explicit:
    """What trains a network with an eye besides its forecasts.

    Attributes
    ----------
    reading
        Loss of what the eye reads of the frames; None leaves a taught eye as it is.
    motion
        Loss of balls that are moved from their true states over the true ground, so that motion is
        learned while the eye cannot see yet; None judges them as forecasts are.
    practice
        Such windows beside every batch; they cost no rendering.
    curriculum
        Horizons of the practice.
    motion_rate
        Learning rate of what moves explicit balls, relative to everything else's: trained motion is
        thrown off by the rate that an eye needs.
    blind
        Share of the budget in which there is practice alone.
    """

    reading: ReadingLoss | None
    motion: MotionLoss | None
    practice: int
    curriculum: tuple[Milestone, ...]
    motion_rate: float = 1.0
    blind: float = 0.0


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
    objects: int
    sequences: int
    curriculum: tuple[Milestone, ...]
    batch_size: int = 32
    learning_rate: float = 1e-3
    optimiser: Callable[[Iterable[dict[str, Any]], float], torch.optim.Optimizer] = adamw
    schedule: Callable[[], Schedule] = Cosine
    heads_alone: float = 0.0
    """Share of the budget in which only the heads learn: fresh heads would spoil what is shared."""
    gradient_clip: float = 2.0
    """Longest gradient, in multiples of the usual length: one batch cannot throw a rollout off."""
    average_decay: float = 0.999
    """Of the exponential moving average of the weights, which is what gets evaluated."""
    validation_scenes: int = 100
    seed: int = 1

    final_step: int | None = None
    """Forecast step that a fifth frame shows (InterpNet); None leaves that frame out."""
    angular_velocity: bool = True
    interaction: bool = True
    """Whether several balls know of each other."""
    explicit: Explicit | None = None
    """For networks with an explicit state."""

    def build(self) -> Family:
        """Make the untrained networks."""
        return PRESETS[self.preset](
            {member.name: member.variant for member in self.members},
            self.frames,
            self.objects,
            angular_velocity=self.angular_velocity,
            interaction=self.interaction,
        )

    @property
    def frames(self) -> Literal[4, 5]:
        """Frames that the networks read: the observed ones and perhaps the final one."""
        return 4 if self.final_step is None else 5

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


FIELD_DATA = (
    DataShare(Source("hemisphere"), 2000, 0.14, 200),
    DataShare(Source("ellipsoid"), 4000, 0.36, 200),
    DataShare(Source("heightfield"), 3000, 0.46, 140),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
)
"""The same with more scenes: what limits an explicit state is the eye."""


def one_ball() -> Recipe:
    """PosNet, DispNet and ProbNet for one ball in all scenarios, from nothing.

    The rollout's early steps weigh more: a plain mean loses their precision.
    """
    return Recipe(
        name="one-ball",
        preset="compact",
        members=_extrapolating(suffix=""),
        spin_loss=SpinLoss(halving=8),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        objects=1,
        sequences=280_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.35, 10), Milestone(0.65, 20)),
    )


def continued(recipe: Recipe) -> Recipe:
    """Train from weights that already forecast.

    A convolutional state stays at its last horizon. An explicit one begins with its eye alone
    again: gradients through a rollout on heightfields are heavy-tailed, and dear.
    """
    longest = recipe.trained_horizon
    if recipe.explicit is None:
        return replace(recipe, curriculum=(Milestone(0, longest),))
    if recipe.explicit.motion is None:
        practice = replace(recipe.explicit, curriculum=(Milestone(0, longest),), blind=0.5)
        return replace(recipe, curriculum=(Milestone(0, longest),), explicit=practice)
    return replace(
        recipe,
        curriculum=(Milestone(0.7, 1), Milestone(0.75, longest // 2), Milestone(0.88, longest)),
        explicit=replace(
            recipe.explicit,
            practice=64,
            curriculum=(Milestone(0, longest // 2),),
            motion_rate=0.1,
        ),
    )


def one_ball_continued() -> Recipe:
    """Train the same from weights that already forecast (``--init``)."""
    return replace(
        continued(one_ball()), name="one-ball-continued", sequences=144_000, learning_rate=4e-4
    )


def one_ball_annealed() -> Recipe:
    """Let weights that already forecast settle: a short, slow last stretch (``--init``)."""
    return replace(
        one_ball_continued(),
        name="one-ball-annealed",
        sequences=27_200,
        learning_rate=2e-4,
        average_decay=0.995,
    )


def one_ball_between() -> Recipe:
    """InterpNet for one ball in all scenarios; it sees step 39."""
    return replace(
        one_ball(),
        name="one-ball-between",
        members=(_interpolating(suffix=""),),
        sequences=200_000,
        curriculum=(Milestone(0.0, 10), Milestone(0.3, 20), Milestone(0.6, 40)),
        final_step=39,
    )


def several_balls(objects: int) -> Recipe:
    """PosNet, DispNet and ProbNet for two or three balls in ellipsoidal bowls."""
    return replace(
        one_ball(),
        name=f"{objects}-balls",
        members=_extrapolating(suffix=f"-{objects}"),
        data=(DataShare(Source("ellipsoid", objects), 1500, 1.0, 200),),
        scenarios=("ellipsoid",),
        objects=objects,
        sequences=200_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.3, 8), Milestone(0.6, 15)),
    )


def several_balls_between(objects: int) -> Recipe:
    """InterpNet for two or three balls; it sees step 29."""
    return replace(
        several_balls(objects),
        name=f"{objects}-balls-between",
        members=(_interpolating(suffix=f"-{objects}"),),
        curriculum=(Milestone(0.0, 8), Milestone(0.3, 15), Milestone(0.6, 30)),
        final_step=29,
    )


def field_one_ball() -> Recipe:
    """FieldNet for one ball in all scenarios, from nothing: eye and motion first, then both."""
    return replace(
        one_ball(),
        name="field-one-ball",
        preset="field",
        members=(_explicit(suffix=""),),
        data=FIELD_DATA,
        sequences=320_000,
        curriculum=(Milestone(0.3, 1), Milestone(0.5, 20), Milestone(0.7, 20), Milestone(0.9, 40)),
        explicit=Explicit(
            ReadingLoss(),
            MotionLoss(halving=8),
            practice=128,
            curriculum=(Milestone(0, 2), Milestone(0.3, 20)),
        ),
        learning_rate=1.5e-3,
    )


def field_one_ball_continued() -> Recipe:
    """Train the same from weights that already see (``--init``)."""
    return replace(
        continued(field_one_ball()), name="field-one-ball-continued", sequences=128_000, seed=4
    )


def field_one_ball_rolling() -> Recipe:
    """Train the motion alone, over what a taught eye reads (``--init``).

    Slowly, and not to T_gen: beyond some 30 steps on heightfields the gradients throw it off.
    """
    recipe = field_one_ball()
    assert recipe.explicit is not None
    horizons = (Milestone(0, 20), Milestone(0.3, 26))
    return replace(
        recipe,
        name="field-one-ball-rolling",
        sequences=96_000,
        curriculum=horizons,
        explicit=replace(recipe.explicit, reading=None, curriculum=horizons),
        learning_rate=3e-4,
        average_decay=0.995,
        seed=5,
    )


def field_several_balls(objects: int) -> Recipe:
    """FieldNet for two or three balls in ellipsoidal bowls, from one ball's (``--init``).

    Encounters are new to it, so it practises them while the eye learns to tell the balls apart.
    """
    fresh = field_one_ball()
    assert fresh.explicit is not None
    practice = replace(
        fresh.explicit, curriculum=(Milestone(0, 2), Milestone(0.4, 15)), motion_rate=0.3
    )
    return replace(
        fresh,
        name=f"field-{objects}-balls",
        members=(_explicit(suffix=f"-{objects}"),),
        # Three balls take a second of simulation a scene.
        data=(DataShare(Source("ellipsoid", objects), 2000 if objects == 2 else 1200, 1.0, 200),),
        scenarios=("ellipsoid",),
        objects=objects,
        sequences=144_000,
        curriculum=(Milestone(0.5, 1), Milestone(0.6, 15), Milestone(0.8, 30)),
        explicit=practice,
    )


def sighted_one_ball() -> Recipe:
    """PosNet, DispNet and ProbNet for one ball with FieldNet's eye (``--init models/fieldnet/1``).

    The eye stays as it is. Transition and heads practise from the truth first, which costs neither
    rendering nor seeing, and then learn what the eye misreads.
    """
    return replace(
        one_ball(),
        name="sighted-one-ball",
        preset="sighted",
        data=FIELD_DATA,
        sequences=160_000,
        curriculum=(Milestone(0.05, 2), Milestone(0.2, 8), Milestone(0.5, 20)),
        explicit=Explicit(
            None, None, practice=32, curriculum=(Milestone(0.05, 2), Milestone(0.5, 20)), blind=0.7
        ),
        learning_rate=1.5e-3,
    )


def sighted_one_ball_between() -> Recipe:
    """InterpNet with FieldNet's eye, which learns to read the final frame too."""
    return _interpolated(sighted_one_ball(), one_ball_between())


def sighted_several_balls(objects: int) -> Recipe:
    """PosNet, DispNet and ProbNet for two or three balls with the eye of FieldNet for as many."""
    compact = several_balls(objects)
    return replace(
        sighted_one_ball(),
        name=f"sighted-{objects}-balls",
        members=compact.members,
        data=field_several_balls(objects).data,
        scenarios=compact.scenarios,
        objects=objects,
        curriculum=(Milestone(0.05, 2), Milestone(0.2, 6), Milestone(0.5, 15)),
    )


def sighted_several_balls_between(objects: int) -> Recipe:
    """InterpNet for two or three balls with the eye of FieldNet for as many."""
    return _interpolated(sighted_several_balls(objects), several_balls_between(objects))


def _interpolated(recipe: Recipe, between: Recipe) -> Recipe:
    """Return a sighted recipe with the members of one that sees the final frame."""
    longest = between.trained_horizon
    return replace(
        recipe,
        name=f"{recipe.name}-between",
        members=between.members,
        final_step=between.final_step,
        curriculum=(Milestone(0.05, 2), Milestone(0.2, 10), Milestone(0.6, longest)),
        explicit=Explicit(
            ReadingLoss(between.final_step),
            None,
            practice=32,
            curriculum=(Milestone(0.05, 2), Milestone(0.6, longest)),
            blind=0.7,
        ),
    )


def paper_posnet() -> Recipe:
    """PosNet as published, on ellipsoidal bowls; give it ImageNet's weights (``--imagenet``)."""
    return replace(
        one_ball(),
        name="paper-posnet",
        preset="paper",
        members=(Member("paper-posnet", "posnet", SquaredLoss()),),
        spin_loss=SpinLoss(halving=math.inf, weight=1, squared=True),
        data=(DataShare(Source("ellipsoid"), 1800, 1.0, 200),),
        scenarios=("ellipsoid",),
        sequences=17_500_000,
        curriculum=(Milestone(0, 20),),
        batch_size=50,
        learning_rate=1e-4,
        optimiser=torch.optim.RMSprop,
        schedule=Plateau,
        gradient_clip=math.inf,
    )


def _extrapolating(suffix: str) -> tuple[Member, ...]:
    """Networks that see four frames; the suffix tells their exported models apart."""
    return (
        Member(f"posnet{suffix}", "posnet", DistanceLoss(halving=8)),
        Member(f"dispnet{suffix}", "dispnet", DistanceLoss(halving=8), weight=0.5),
        Member(f"probnet{suffix}", "probnet", LikelihoodLoss(halving=8)),
    )


def _explicit(suffix: str) -> Member:
    """Return the network with an explicit state, which also says how sure it is."""
    loss = DoubtLoss(DistanceLoss(halving=8, rounding=0.1), LikelihoodLoss(halving=8), weight=0.2)
    return Member(f"fieldnet{suffix}", "fieldnet", loss)


def _interpolating(suffix: str) -> Member:
    """Return the network that sees the final frame too; its hardest steps are in the middle."""
    return Member(f"interpnet{suffix}", "interpnet", DistanceLoss(halving=40))


RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "one-ball": one_ball,
    "one-ball-continued": one_ball_continued,
    "one-ball-annealed": one_ball_annealed,
    "one-ball-between": one_ball_between,
    "2-balls": partial(several_balls, 2),
    "3-balls": partial(several_balls, 3),
    "2-balls-between": partial(several_balls_between, 2),
    "3-balls-between": partial(several_balls_between, 3),
    "field-one-ball": field_one_ball,
    "field-one-ball-continued": field_one_ball_continued,
    "field-one-ball-rolling": field_one_ball_rolling,
    "field-2-balls": partial(field_several_balls, 2),
    "field-3-balls": partial(field_several_balls, 3),
    "sighted-one-ball": sighted_one_ball,
    "sighted-one-ball-between": sighted_one_ball_between,
    "sighted-2-balls": partial(sighted_several_balls, 2),
    "sighted-3-balls": partial(sighted_several_balls, 3),
    "sighted-2-balls-between": partial(sighted_several_balls_between, 2),
    "sighted-3-balls-between": partial(sighted_several_balls_between, 3),
    "paper-posnet": paper_posnet,
}
