"""Experiments by name: functions that return their complete configuration."""

from collections.abc import Callable, Mapping
from functools import partial

from rollcast.scene import MAX_FORECAST_OBJECTS
from training.recipes.appearance import field_one_ball_appearance
from training.recipes.compact import (
    one_ball,
    one_ball_interpolation,
    several_balls,
    several_balls_interpolation,
)
from training.recipes.field import (
    field_one_ball,
    field_one_ball_continued,
    field_one_ball_covariance,
    field_one_ball_interpolation,
    field_one_ball_rolling,
    field_one_ball_seeing,
    field_several_balls,
    field_several_balls_interpolation,
)
from training.recipes.paper import paper_dispnet, paper_interpnet, paper_posnet, paper_probnet
from training.recipes.perception_init import (
    perception_init_one_ball,
    perception_init_one_ball_further,
    perception_init_one_ball_interpolation,
    perception_init_several_balls,
    perception_init_several_balls_further,
    perception_init_several_balls_interpolation,
)
from training.recipes.recipe import Recipe
from training.recipes.setup import setup, setup_continued, setup_seeing
from training.recipes.tiny import tiny

RECIPES: Mapping[str, Callable[[], Recipe]] = {
    "tiny": tiny,
    "one-ball": one_ball,
    "one-ball-interpolation": one_ball_interpolation,
    "2-balls": partial(several_balls, 2),
    "3-balls": partial(several_balls, 3),
    "2-balls-interpolation": partial(several_balls_interpolation, 2),
    "3-balls-interpolation": partial(several_balls_interpolation, 3),
    "field-one-ball": field_one_ball,
    "field-one-ball-continued": field_one_ball_continued,
    "field-one-ball-seeing": field_one_ball_seeing,
    "field-one-ball-rolling": field_one_ball_rolling,
    "field-one-ball-covariance": field_one_ball_covariance,
    "field-one-ball-appearance": field_one_ball_appearance,
    "field-2-balls": partial(field_several_balls, 2),
    "field-3-balls": partial(field_several_balls, 3),
    "field-one-ball-interpolation": field_one_ball_interpolation,
    "field-2-balls-interpolation": partial(field_several_balls_interpolation, 2),
    "field-3-balls-interpolation": partial(field_several_balls_interpolation, 3),
    "perception-init-one-ball": perception_init_one_ball,
    "perception-init-one-ball-further": perception_init_one_ball_further,
    "perception-init-one-ball-interpolation": perception_init_one_ball_interpolation,
    "perception-init-2-balls": partial(perception_init_several_balls, 2),
    "perception-init-3-balls": partial(perception_init_several_balls, 3),
    "perception-init-2-balls-further": partial(perception_init_several_balls_further, 2),
    "perception-init-3-balls-further": partial(perception_init_several_balls_further, 3),
    "perception-init-2-balls-interpolation": partial(
        perception_init_several_balls_interpolation, 2
    ),
    "perception-init-3-balls-interpolation": partial(
        perception_init_several_balls_interpolation, 3
    ),
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
