"""The paper's networks over a state that begins with what FieldNet's eye reads."""

from dataclasses import replace

from training.models.task import Task
from training.recipes.compact import (
    one_ball,
    one_ball_between,
    several_balls,
    several_balls_between,
)
from training.recipes.field import FIELD_DATA, field_several_balls
from training.recipes.recipe import Explicit, Milestone, Recipe


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
    """InterpNet with FieldNet's eye."""
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
        task=Task(objects),
        curriculum=(Milestone(0.05, 2), Milestone(0.2, 6), Milestone(0.5, 15)),
    )


def sighted_several_balls_between(objects: int) -> Recipe:
    """InterpNet for two or three balls with the eye of FieldNet for as many."""
    return _interpolated(sighted_several_balls(objects), several_balls_between(objects))


def _interpolated(recipe: Recipe, between: Recipe) -> Recipe:
    """Return a sighted recipe with the members of one that sees the final frame."""
    longest = between.trained_horizon
    assert recipe.explicit is not None
    return replace(
        recipe,
        name=f"{recipe.name}-between",
        members=between.members,
        task=between.task,
        curriculum=(Milestone(0.05, 2), Milestone(0.2, 10), Milestone(0.6, longest)),
        explicit=replace(recipe.explicit, curriculum=(Milestone(0.05, 2), Milestone(0.6, longest))),
    )
