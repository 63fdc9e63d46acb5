"""Experiments by name: functions that return their complete configuration."""

from collections.abc import Callable, Mapping
from functools import partial

from rollcast.scene import MAX_FORECAST_OBJECTS
from training.recipes.appearance import field_one_ball_appearance
from training.recipes.compact import (
    one_ball,
    one_ball_between,
    several_balls,
    several_balls_between,
)
from training.recipes.field import (
    field_one_ball,
    field_one_ball_between,
    field_one_ball_continued,
    field_one_ball_doubt,
    field_one_ball_rolling,
    field_one_ball_seeing,
    field_several_balls,
    field_several_balls_between,
)
from training.recipes.paper import paper_dispnet, paper_interpnet, paper_posnet, paper_probnet
from training.recipes.recipe import Recipe
from training.recipes.setup import setup, setup_continued, setup_seeing
from training.recipes.sighted import (
    sighted_one_ball,
    sighted_one_ball_between,
    sighted_one_ball_further,
    sighted_several_balls,
    sighted_several_balls_between,
    sighted_several_balls_further,
)
from training.recipes.tiny import tiny

RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "tiny": tiny,
    "one-ball": one_ball,
    "one-ball-between": one_ball_between,
    "2-balls": partial(several_balls, 2),
    "3-balls": partial(several_balls, 3),
    "2-balls-between": partial(several_balls_between, 2),
    "3-balls-between": partial(several_balls_between, 3),
    "field-one-ball": field_one_ball,
    "field-one-ball-continued": field_one_ball_continued,
    "field-one-ball-seeing": field_one_ball_seeing,
    "field-one-ball-rolling": field_one_ball_rolling,
    "field-one-ball-doubt": field_one_ball_doubt,
    "field-one-ball-appearance": field_one_ball_appearance,
    "field-2-balls": partial(field_several_balls, 2),
    "field-3-balls": partial(field_several_balls, 3),
    "field-one-ball-between": field_one_ball_between,
    "field-2-balls-between": partial(field_several_balls_between, 2),
    "field-3-balls-between": partial(field_several_balls_between, 3),
    "sighted-one-ball": sighted_one_ball,
    "sighted-one-ball-further": sighted_one_ball_further,
    "sighted-one-ball-between": sighted_one_ball_between,
    "sighted-2-balls": partial(sighted_several_balls, 2),
    "sighted-3-balls": partial(sighted_several_balls, 3),
    "sighted-2-balls-further": partial(sighted_several_balls_further, 2),
    "sighted-3-balls-further": partial(sighted_several_balls_further, 3),
    "sighted-2-balls-between": partial(sighted_several_balls_between, 2),
    "sighted-3-balls-between": partial(sighted_several_balls_between, 3),
    "paper-posnet": paper_posnet,
    "paper-dispnet": paper_dispnet,
    "paper-probnet": paper_probnet,
    "paper-interpnet": paper_interpnet,
    **{
        stage(objects).name: partial(stage, objects)
        for stage in (setup, setup_seeing, setup_continued)
        for objects in range(1, MAX_FORECAST_OBJECTS + 1)
    },
}


def summary(name: str) -> str:
    """Return the first line of a recipe's docstring."""
    made = RECIPES[name]
    function = made.func if isinstance(made, partial) else made
    return (function.__doc__ or "").strip().splitlines()[0].replace("``", "")
