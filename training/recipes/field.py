"""FieldNet: directly supervised perception, and balls with an explicit state."""

from dataclasses import replace

from rollcast.scene import SMALL_RADIUS_M
from training.data.shards import Source
from training.networks.task import Task
from training.objectives.losses import (
    DetachedNllLoss,
    DistanceLoss,
    LikelihoodLoss,
    MotionLoss,
    PerceptionLoss,
    SpinLoss,
)
from training.recipes.recipe import DataShare, Explicit, Member, Milestone, Recipe, continued

FIELD_DATA = (
    DataShare(Source("hemisphere"), 2000, 0.14, 200),
    DataShare(Source("ellipsoid"), 4000, 0.36, 200),
    DataShare(Source("heightfield"), 3000, 0.46, 140),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
)
"""Distributions of the compact recipes with more scenes, because the perception limits an
explicit state."""


def field_one_ball() -> Recipe:
    """FieldNet for one ball in all scenarios, from random weights.

    Perception and motion are trained separately first, then together.
    """
    return Recipe(
        name="field-one-ball",
        preset="field",
        members=(_explicit("fieldnet", halving=8),),
        spin_loss=SpinLoss(halving=8),
        data=FIELD_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        task=Task(),
        sequences=320_000,
        curriculum=(Milestone(0.3, 1), Milestone(0.5, 20), Milestone(0.7, 20), Milestone(0.9, 40)),
        explicit=Explicit(
            PerceptionLoss(),
            MotionLoss(halving=8),
            true_state_windows=128,
            curriculum=(Milestone(0, 2), Milestone(0.3, 20)),
        ),
        learning_rate=1.5e-3,
    )


def field_one_ball_continued() -> Recipe:
    """Continue the training of FieldNet for one ball (``--init``)."""
    return replace(
        continued(field_one_ball()), name="field-one-ball-continued", sequences=128_000, seed=4
    )


def field_one_ball_seeing() -> Recipe:
    """Train the perception of a trained FieldNet (``--init``), without its motion.

    Rollouts follow at the end, because perception learns several times as fast without them. The
    covariance must be trained afterwards.
    """
    recipe = field_one_ball()
    assert recipe.explicit is not None
    return replace(
        recipe,
        name="field-one-ball-seeing",
        sequences=384_000,
        curriculum=(Milestone(0, 1), Milestone(0.97, 1), Milestone(1, 20)),
        explicit=replace(
            recipe.explicit, motion=None, true_state_windows=0, curriculum=(Milestone(0, 1),)
        ),
        frozen=("rolling.", "first_covariance."),
        seed=6,
    )


def field_one_ball_rolling() -> Recipe:
    """Train the motion of a trained FieldNet (``--init``), with frozen perception.

    The learning rate is small and constant, and the horizon below T_gen: beyond about 30 steps on
    heightfields, the gradients destabilise the training.
    """
    recipe = field_one_ball()
    assert recipe.explicit is not None
    horizons = (Milestone(0, 20), Milestone(0.3, 26))
    return replace(
        recipe,
        name="field-one-ball-rolling",
        sequences=96_000,
        curriculum=horizons,
        explicit=replace(
            recipe.explicit, perception=None, true_state_windows=64, curriculum=horizons
        ),
        frozen=("perception.",),
        learning_rate=3e-4,
        gradient_clip=0.5,
        average_decay=0.995,
        seed=5,
    )


def field_one_ball_covariance() -> Recipe:
    """Train the covariance of a trained FieldNet (``--init``), up to T_gen.

    No gradients pass through the rollout, so the long horizon does not destabilise the training.
    """
    recipe = field_one_ball_rolling()
    motion = ("layers.", "change.", "linear.")
    return replace(
        recipe,
        name="field-one-ball-covariance",
        members=(_explicit("fieldnet", halving=40, outlier=5.0),),
        sequences=384_000,
        curriculum=(Milestone(0, 40),),
        explicit=None,
        frozen=("perception.", "first_covariance.", *(f"rolling.{part}" for part in motion)),
        replay_windows=24_000,
        batch_size=256,
        learning_rate=2e-3,
        gradient_clip=2.0,
        average_decay=0.99,
        seed=1,
    )


def field_several_balls(objects: int) -> Recipe:
    """FieldNet for two or three balls in ellipsoidal bowls, from one for one ball (``--init``).

    Pair interactions are trained from true states while the perception learns to distinguish the
    balls.
    """
    fresh = field_one_ball()
    assert fresh.explicit is not None
    explicit = replace(
        fresh.explicit, curriculum=(Milestone(0, 2), Milestone(0.4, 15)), motion_rate=0.3
    )
    return replace(
        fresh,
        name=f"field-{objects}-balls",
        members=(_explicit(f"fieldnet-{objects}", halving=8),),
        # Three balls take a second of simulation a scene.
        data=(DataShare(Source("ellipsoid", objects), 2000 if objects == 2 else 1200, 1.0, 200),),
        scenarios=("ellipsoid",),
        task=Task(objects),
        sequences=144_000,
        curriculum=(Milestone(0.5, 1), Milestone(0.6, 15), Milestone(0.8, 30)),
        explicit=explicit,
    )


def field_one_ball_interpolation() -> Recipe:
    """FieldNet with a final frame: trains the endpoint correction of a FieldNet (``--init``)."""
    return _interpolation(
        field_one_ball(), "field-one-ball-interpolation", "fieldnet-interpolation", final_step=39
    )


def field_several_balls_interpolation(objects: int) -> Recipe:
    """FieldNet with a final frame for two or three balls (``--init``)."""
    name, member = f"field-{objects}-balls-interpolation", f"fieldnet-{objects}-interpolation"
    recipe = _interpolation(field_several_balls(objects), name, member, final_step=29)
    # Ways in bowls end well by themselves: there is little to learn.
    return replace(recipe, sequences=128_000, replay_windows=6_400)


def _interpolation(recipe: Recipe, name: str, member: str, final_step: int) -> Recipe:
    """Return a recipe for the endpoint correction; perception and motion are frozen."""
    return replace(
        recipe,
        name=name,
        members=(_explicit(member, halving=final_step),),
        task=replace(recipe.task, final_step=final_step),
        sequences=640_000,
        curriculum=(Milestone(0, final_step + 1),),
        explicit=None,
        frozen=("perception.", "rolling.", "first_covariance."),
        replay_windows=24_000,
        batch_size=256,
        learning_rate=2e-3,
        average_decay=0.99,
    )


def _explicit(name: str, halving: float, outlier: float = 3.0) -> Member:
    """Return the network with an explicit state and a predicted covariance."""
    # The paper's regulariser would hold a variance at 16 px^2 where the errors' is 100 px^2.
    likelihood = LikelihoodLoss(halving, regulariser=0.0, outlier=outlier)
    distance = DistanceLoss(halving, rounding=0.1)
    return Member(name, "fieldnet", DetachedNllLoss(distance, likelihood, weight=0.2))
