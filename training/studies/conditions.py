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
"""Bounds of four bins with equal numbers of scenes; smaller scales mean more hills."""

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
    """Errors of the committed one-ball models on the 500 heightfields of the test split, in four
groups by noise scale: the side of a cell of the noise lattice in metres. A smaller scale puts more
hills in the path of a ball. The groups are about equally large. Scales are sampled uniformly from
0.2 to 0.7, but at small scales few balls keep moving for the 250 frames that the paper requires, so
that only 1 % of the scenes lie below 0.48. Mean position error in pixels of 128 x 128 frames at
T_train = 20 and T_gen = 40. No model was trained for this table.""",
    tuple(
        BenchmarkCase("heightfield", scene_filter=SceneFilter("noise_scale", low, high))
        for low, high in pairwise(NOISE_SCALES)
    ),
    _rows,
    by_scenes=True,
)

UNUSUAL = Study(
    "unusual",
    "Outside the training distribution",
    f"""Errors of the committed one-ball models on scenes with one property outside the training
distribution, beside scenes within it: another radius (trained on {TRAINED_RADII};
the paper has these two radii),
other speeds, narrower bowls (trained on axis ratios of 0.5 to 1; below 0.47 a ball of the default
size does not reach the bottom, so these bowls have smaller balls), other lights (trained with a
light 2 m high, beyond a corner) and white balls (trained on coloured ones). Mean position error in
pixels of 128 x 128 frames at T_train = 20 and T_gen = 40. No model was trained for this table. The
service warns about frames that look unlike the training data.""",
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
