import math

import pytest
from pydantic import ValidationError

from rollcast.scene import MAX_SEED, Scene

BALL = {
    "positions_m": ((0.1, 0.2, 0.3),),
    "velocities_m_s": ((1.0, 2.0, 3.0),),
    "orientations_xyzw": ((0.0, 0.0, 0.0, 1.0),),
}
COMMON = {"seed": 7, "textured": True, "radius_m": 0.225, "rotation_rad": 0.5, **BALL}
BOWL = {"scenario": "ellipsoid", "axis_ratio": 0.7, **COMMON}
HEIGHTFIELD = {
    "scenario": "heightfield",
    "noise_scale": 0.5,
    "noise_offset_m": (1.0, -1.0),
    "light_position_m": (1.2, -1.3, 2.0),
    **COMMON,
}


def balls(count: int) -> dict[str, object]:
    return {name: value * count for name, value in BALL.items()}


TWO_BALLS = BOWL | {"textured": False} | balls(2)


@pytest.mark.parametrize("fields", [BOWL, HEIGHTFIELD, BOWL | {"textured": False} | balls(3)])
def test_a_scene_survives_json(fields):
    scene = Scene(**fields)
    assert Scene.model_validate_json(scene.model_dump_json()) == scene


def test_a_scene_cannot_be_changed():
    scene = Scene(**BOWL)
    with pytest.raises(ValidationError, match="frozen"):
        scene.seed = 8


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (BOWL | {"scenario": "torus"}, "scenario"),
        (BOWL | {"seed": -1}, "seed"),
        (BOWL | {"seed": MAX_SEED + 1}, "seed"),
        (BOWL | {"radius_m": 0.02}, "radius_m"),
        (BOWL | {"radius_m": 0.3}, "radius_m"),
        (BOWL | {"radius_m": math.nan}, "radius_m"),
        (BOWL | {"rotation_rad": math.inf}, "rotation_rad"),
        (BOWL | {"positions_m": ((0.0, math.nan, 0.0),)}, "positions_m"),
        (BOWL | {"axis_ratio": 0.3}, "axis_ratio"),
        (BOWL | {"axis_ratio": None}, "needs axis_ratio"),
        (BOWL | {"noise_scale": 0.5}, "has no noise_scale"),
        (BOWL | {"light_position_m": (1.0, 1.0, 2.0)}, "has no light_position_m"),
        (BOWL | {"scenario": "hemisphere"}, "hemisphere is 1, not 0.7"),
        (HEIGHTFIELD | {"axis_ratio": 1.0}, "has no axis_ratio"),
        (HEIGHTFIELD | {"noise_offset_m": None}, "needs noise_offset_m"),
        (HEIGHTFIELD | {"noise_scale": 0.19}, "noise_scale"),
        (BOWL | balls(0), "positions_m\n.*at least 1 item"),
        (BOWL | {"textured": False} | balls(99), "positions_m\n.*at most"),
        (TWO_BALLS | {"velocities_m_s": ((1, 2, 3),)}, "velocities_m_s has 1 entries for 2 balls"),
        (BOWL | {"orientations_xyzw": ()}, "orientations_xyzw has 0 entries"),
        (BOWL | balls(2), "textured must be false"),
        (BOWL | {"gravity": 9.81}, "gravity"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(fields, message):
    with pytest.raises(ValidationError, match=message):
        Scene(**fields)
