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
from training.recipes.paper import paper_posnet
from training.recipes.recipe import Recipe
from training.recipes.rig import rig, rig_continued, rig_seeing
from training.recipes.sighted import (
    sighted_one_ball,
    sighted_one_ball_between,
    sighted_several_balls,
    sighted_several_balls_between,
)

RECIPES: Mapping[str, Callable[[], Recipe]] = {
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
    "sighted-one-ball-between": sighted_one_ball_between,
    "sighted-2-balls": partial(sighted_several_balls, 2),
    "sighted-3-balls": partial(sighted_several_balls, 3),
    "sighted-2-balls-between": partial(sighted_several_balls_between, 2),
    "sighted-3-balls-between": partial(sighted_several_balls_between, 3),
    "paper-posnet": paper_posnet,
    **{
        stage(objects).name: partial(stage, objects)
        for stage in (rig, rig_seeing, rig_continued)
        for objects in range(1, MAX_FORECAST_OBJECTS + 1)
    },
}
