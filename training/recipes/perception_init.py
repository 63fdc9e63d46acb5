"""The paper's networks with a state that is initialised by FieldNet's perception."""

from dataclasses import replace

from training.data.windows import generated_horizon
from training.networks.task import Task
from training.recipes.compact import (
    one_ball,
    one_ball_interpolation,
    several_balls,
    several_balls_interpolation,
)
from training.recipes.field import FIELD_DATA, field_several_balls
from training.recipes.recipe import Explicit, Milestone, Recipe


def perception_init_one_ball() -> Recipe:
    """PosNet, DispNet and ProbNet for one ball, from FieldNet (``--init models/fieldnet/1``).

    The perception is frozen, so its outputs are cached. Transition and heads are trained on cached
    outputs, and on true states of which there are arbitrarily many.
    """
    horizons = (Milestone(0.05, 2), Milestone(0.5, 20))
    return replace(
        one_ball(),
        name="perception-init-one-ball",
        preset="perception_init",
        data=FIELD_DATA,
        sequences=160_000,
        curriculum=horizons,
        explicit=Explicit(None, None, true_state_windows=32, curriculum=horizons),
        frozen=("encoder.perception.",),
        replay_windows=24_000,
        learning_rate=1.5e-3,
    )


def perception_init_one_ball_further() -> Recipe:
    """Train PosNet, DispNet and ProbNet of perception-init-one-ball (``--init``) up to T_gen.

    Trained for 20 steps, they lose the ball in a bowl soon after: 9 px at T = 40, where the
    same state can follow it (docs/experiments.md). The perception stays frozen.
    """
    return _further(perception_init_one_ball(), sequences=48_000)


def perception_init_several_balls_further(objects: int) -> Recipe:
    """Train PosNet, DispNet and ProbNet for two or three balls (``--init``) up to T_gen."""
    return _further(perception_init_several_balls(objects), sequences=24_000)


def _further(recipe: Recipe, sequences: int) -> Recipe:
    """Return a recipe that continues to the longest horizon that the paper reports."""
    horizons = (
        Milestone(0, recipe.trained_horizon),
        Milestone(0.3, generated_horizon(recipe.task.objects)),
    )
    assert recipe.explicit is not None
    return replace(
        recipe,
        name=f"{recipe.name}-further",
        data=tuple(replace(part, scenes=min(part.scenes, 1600)) for part in recipe.data),
        sequences=sequences,
        curriculum=horizons,
        explicit=replace(recipe.explicit, curriculum=horizons),
        learning_rate=8e-4,
        seed=7,
    )


def perception_init_one_ball_interpolation() -> Recipe:
    """InterpNet for one ball, from FieldNet's perception and trained motion (``--init``)."""
    return _interpolated(perception_init_one_ball(), one_ball_interpolation())


def perception_init_several_balls(objects: int) -> Recipe:
    """PosNet, DispNet and ProbNet for two or three balls, from FieldNet for as many (``--init``).

    The motion starts from a network for one ball and lacks only the pair interactions.
    """
    compact, one = several_balls(objects), perception_init_one_ball()
    horizons = (Milestone(0, 5), Milestone(0.3, 15))
    assert one.explicit is not None
    return replace(
        one,
        name=f"perception-init-{objects}-balls",
        members=compact.members,
        data=field_several_balls(objects).data,
        scenarios=compact.scenarios,
        task=Task(objects),
        sequences=44_800,
        replay_windows=12_800,
        curriculum=horizons,
        explicit=replace(one.explicit, curriculum=horizons),
    )


def perception_init_several_balls_interpolation(objects: int) -> Recipe:
    """InterpNet for two or three balls, from perception and motion for as many (``--init``)."""
    recipe = _interpolated(
        perception_init_several_balls(objects), several_balls_interpolation(objects)
    )
    # Ways in bowls end well by themselves: there is less to learn than with one ball everywhere.
    return replace(recipe, sequences=17_920)


def _interpolated(recipe: Recipe, interpolation: Recipe) -> Recipe:
    """Return a perception-initialised recipe with a final frame."""
    horizons = (Milestone(0, 5), Milestone(0.4, interpolation.trained_horizon))
    assert recipe.explicit is not None
    return replace(
        recipe,
        name=f"{recipe.name}-interpolation",
        members=interpolation.members,
        task=interpolation.task,
        sequences=recipe.sequences * 3 // 5,
        curriculum=horizons,
        explicit=replace(recipe.explicit, curriculum=horizons),
    )
