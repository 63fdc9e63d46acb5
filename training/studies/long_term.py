"""Long-term prediction: one ball in three scenarios, two and three in ellipsoidal bowls."""

from dataclasses import replace
from pathlib import Path

from training.networks.task import Task
from training.recipes.compact import ONE_BALL_DATA, one_ball, several_balls
from training.recipes.recipe import Recipe
from training.studies.benchmark_case import BenchmarkCase
from training.studies.frame_rows import v_lstm, vin
from training.studies.network_rows import ours, shipped
from training.studies.rows import (
    COMPACT,
    IMPACTS,
    LEGEND,
    PLAIN,
    Row,
    constant_position,
    least_squares,
    middle_of_frame,
    oracle,
)
from training.studies.state_rows import ifs, npe
from training.studies.study import Study

SIMULATOR_NOISE_PX = (0.25, 0.5)
CAPTION = f"""{LEGEND} Methods with "states" in the column "given" start from true positions. The
row "simulator" is PyBullet restarted from the true state, or from the motion that best fits four
positions with the given noise. Bold marks the best method that observes frames. T_train is
{{trained}}, T_gen {{generated}}."""


MODELS = Path(__file__).parents[2] / "models"
OURS = ("posnet", "dispnet", "probnet")


def _fixed() -> tuple[Row, ...]:
    """Rows that learn nothing."""
    return (
        constant_position(),
        middle_of_frame(),
        least_squares("linear extrapolation", 1),
        least_squares("quadratic", 2),
        oracle(None),
        *(oracle(noise) for noise in SIMULATOR_NOISE_PX),
    )


def of_one_ball(*, angular_velocity: bool) -> Recipe:
    """Return the compact networks, from nothing, on all three scenarios in equal parts."""
    usual = tuple(replace(part, share=1.0) for part in ONE_BALL_DATA if not part.source.radius_m)
    return replace(
        one_ball(),
        name="one-ball" if angular_velocity else "one-ball-plain",
        data=usual,
        task=Task(angular_velocity=angular_velocity),
    )


def _one_ball() -> tuple[Row, ...]:
    return (
        *_fixed(),
        npe(angular_velocity=False),
        npe(angular_velocity=True),
        v_lstm(angular_velocity=False),
        v_lstm(angular_velocity=True),
        ifs(angular_velocity=False),
        ifs(angular_velocity=True),
        vin(),
        *(ours(of_one_ball(angular_velocity=False), name, COMPACT + name + PLAIN) for name in OURS),
        *(ours(of_one_ball(angular_velocity=True), name, COMPACT + name) for name in OURS),
        *(shipped(MODELS / name / "1") for name in (*OURS, "fieldnet")),
    )


def _several_balls() -> tuple[Row, ...]:
    return (
        *_fixed(),
        npe(angular_velocity=True),
        v_lstm(angular_velocity=True),
        ifs(angular_velocity=True),
        *(
            ours(several_balls(objects), f"{name}-{objects}", COMPACT + name)
            for objects in (2, 3)
            for name in OURS
        ),
        *(
            shipped(MODELS / f"{name}-{objects}" / "1")
            for objects in (2, 3)
            for name in (*OURS, "fieldnet")
        ),
    )


LONG_TERM = Study(
    "long-term",
    "Long-term prediction",
    CAPTION.format(trained=20, generated=40),
    (BenchmarkCase("hemisphere"), BenchmarkCase("ellipsoid"), BenchmarkCase("heightfield")),
    _one_ball,
)

SEVERAL_BALLS = Study(
    "several-balls",
    "Two and three balls",
    f"{CAPTION.format(trained=15, generated=30)} {IMPACTS}",
    (BenchmarkCase("ellipsoid", 2), BenchmarkCase("ellipsoid", 3)),
    _several_balls,
)
