"""Where the committed models are at ease: grounds by difficulty, and beyond their training."""

from itertools import pairwise

from rollcast.scene import SMALL_RADIUS_M
from training.data.shards import SceneOverride
from training.studies.benchmark_case import BenchmarkCase, SceneFilter
from training.studies.long_term import MODELS, OURS
from training.studies.network_rows import shipped
from training.studies.rows import Row, constant_position, least_squares
from training.studies.study import Study

NOISE_SCALES = (0.2, 0.574, 0.617, 0.658, 0.7)
"""Ends of four parts that hold equally many scenes: the smaller, the more hills."""

TRAINED_RADII = f"0.225 m, and {SMALL_RADIUS_M:g} m in a few bowls"
SMALL = SceneOverride(f"radius {SMALL_RADIUS_M:g} m", (("radius_m", SMALL_RADIUS_M),))
SMALLER = SceneOverride("radius 0.15 m", (("radius_m", 0.15),))
SLOWER = SceneOverride("half as fast", speed=0.5)
FASTER = SceneOverride("one and a half times as fast", speed=1.5)
NARROWER = SceneOverride("radius 0.15 m, axis ratio 0.4", (("radius_m", 0.15), ("axis_ratio", 0.4)))
LIT_FROM_ABOVE = SceneOverride("lit from above", (("light_position_m", (0.0, 0.0, 2.0)),))
LIT_FROM_BELOW = SceneOverride(
    "lit from the height of 1 m", (("light_position_m", (1.25, 1.25, 1.0)),)
)
PLAIN_WHITE = SceneOverride("white balls", (("textured", False),))


def _rows() -> tuple[Row, ...]:
    return (
        constant_position(),
        least_squares("linear extrapolation", 1),
        *(shipped(MODELS / name / "1") for name in (*OURS, "fieldnet")),
    )


DIFFICULTY = Study(
    "difficulty",
    "Heightfields by difficulty",
    """The committed one-ball models on the heightfields among 500 test scenes, in four parts by the
scale of their noise, the side of a cell of its lattice in metres: the smaller, the more hills lie
in a ball's way. The parts hold equally many scenes: scales are drawn evenly from 0.2 to 0.7, but on
small ones hardly any ball keeps moving for the 250 frames that a scene must last (the paper's
rule), so that only 1 % of the scenes lie below 0.48. Mean position error in 128-pixel units at
T_train = 20 and T_gen = 40; nothing was trained for this table.""",
    tuple(
        BenchmarkCase("heightfield", scene_filter=SceneFilter("noise_scale", low, high))
        for low, high in pairwise(NOISE_SCALES)
    ),
    _rows,
    by_scenes=True,
)

UNUSUAL = Study(
    "unusual",
    "Outside the training",
    f"""The committed one-ball models on scenes of which one thing lies outside their training's
range, beside usual scenes: balls of another radius (trained on {TRAINED_RADII}; the
paper has these two radii), other speeds,
narrower bowls (trained on axis ratios of 0.5 to 1; below 0.47 a ball of the usual size does not
reach the bottom, so that they go with smaller balls), other lights (trained with the light 2 m
high, beyond a corner), white balls (trained on coloured ones). Mean position error in 128-pixel
units at T_train = 20 and T_gen = 40; nothing was trained for this table. The service warns of
frames that look unlike its training.""",
    (
        *(
            BenchmarkCase("hemisphere", override=one)
            for one in (None, SMALL, SMALLER, SLOWER, PLAIN_WHITE)
        ),
        *(
            BenchmarkCase("ellipsoid", override=one)
            for one in (None, SMALL, SMALLER, SLOWER, NARROWER)
        ),
        *(
            BenchmarkCase("heightfield", override=one)
            for one in (None, SMALL, SMALLER, SLOWER, FASTER, LIT_FROM_ABOVE, LIT_FROM_BELOW)
        ),
    ),
    _rows,
    by_scenes=True,
)
