"""Effects of single choices: texture, interaction module, supervision, final frame."""

from dataclasses import replace

from training.data.shards import SceneOverride
from training.networks.task import Task
from training.recipes.compact import one_ball_interpolation, several_balls
from training.recipes.recipe import Milestone, Recipe
from training.studies.benchmark_case import BenchmarkCase
from training.studies.claims import NO_MODULE
from training.studies.conditions import PLAIN_WHITE
from training.studies.long_term import MODELS, OURS, of_one_ball
from training.studies.network_rows import ours, ours_trained_to_each, shipped
from training.studies.rows import (
    COMPACT,
    IMPACTS,
    LEGEND,
    PLAIN,
    Row,
    constant_position,
    middle_of_frame,
)
from training.studies.study import Study

WITHOUT_MODULE = f"{COMPACT}dispnet{NO_MODULE}"
LENGTHS = (10, 20, 30, 40)


def on_ellipsoids(override: SceneOverride | None, *, angular_velocity: bool) -> Recipe:
    """Return the compact networks, from nothing, on one ball in ellipsoidal bowls."""
    usual = of_one_ball(angular_velocity=angular_velocity)
    name = "-".join(
        [
            "ellipsoid",
            *(() if override is None else ("white",)),
            *(() if angular_velocity else ("plain",)),
        ]
    )
    data = tuple(
        replace(part, source=replace(part.source, override=override))
        for part in usual.data
        if part.source.scenario == "ellipsoid"
    )
    return replace(usual, name=name, data=data, scenarios=("ellipsoid",))


def of_several_balls(objects: int, *, interaction: bool) -> Recipe:
    """Return the compact networks, from nothing, with or without the module for several balls."""
    return replace(
        several_balls(objects),
        name=f"{objects}-balls" if interaction else f"{objects}-balls-apart",
        task=Task(objects, interaction=interaction),
    )


def trained_to(steps: int) -> Recipe:
    """Return the compact networks, from nothing, supervised up to T = ``steps``."""
    usual = of_one_ball(angular_velocity=True)
    if steps == usual.curriculum[-1].horizon:
        return usual
    earlier = [one for one in usual.curriculum if one.horizon < steps]
    last = Milestone(usual.curriculum[-1].progress, steps)
    return replace(usual, name=f"one-ball-to-{steps}", curriculum=(*earlier, last))


def between() -> Recipe:
    """Return InterpNet, from nothing, on all three scenarios in equal parts."""
    data = of_one_ball(angular_velocity=True).data
    return replace(one_ball_interpolation(), data=data)


def _textures() -> tuple[Row, ...]:
    return (
        constant_position(),
        middle_of_frame(),
        *(
            ours(
                on_ellipsoids(change, angular_velocity=spin),
                name,
                COMPACT + name + ("" if spin else PLAIN),
            )
            for name in OURS
            for spin in (False, True)
            for change in (None, PLAIN_WHITE)
        ),
    )


def _modules() -> tuple[Row, ...]:
    return (
        constant_position(),
        middle_of_frame(),
        *(
            ours(of_several_balls(objects, interaction=interaction), f"dispnet-{objects}", method)
            for objects in (2, 3)
            for method, interaction in ((WITHOUT_MODULE, False), (f"{COMPACT}dispnet", True))
        ),
        *(
            shipped(MODELS / f"{name}-{objects}" / "1")
            for objects in (2, 3)
            for name in (*OURS, "fieldnet")
        ),
    )


def _interpolation() -> tuple[Row, ...]:
    recipes = {steps: trained_to(steps) for steps in LENGTHS}
    return (
        constant_position(),
        middle_of_frame(),
        ours_trained_to_each(recipes, "dispnet", f"{COMPACT}dispnet trained to T"),
        ours(between(), "interpnet", f"{COMPACT}interpnet"),
        *(
            shipped(MODELS / (name + suffix) / "1")
            for suffix in ("", "-2", "-3")
            for name in ("dispnet", "fieldnet", "interpnet")
        ),
        *(shipped(MODELS / f"fieldnet{part}-interpolation" / "1") for part in ("", "-2", "-3")),
    )


def _supervision() -> tuple[Row, ...]:
    return (
        constant_position(),
        middle_of_frame(),
        *(ours(trained_to(20), name, COMPACT + name) for name in OURS),
        *(ours(trained_to(40), name, f"{COMPACT}{name} supervised to T=40") for name in OURS),
    )


TEXTURE = Study(
    "texture",
    "Textured and white balls",
    f"""Networks trained and tested on ellipsoidal bowls with textured balls, whose rotation is
visible, and with white balls. {LEGEND} T_train is 20, T_gen 40.""",
    (BenchmarkCase("ellipsoid"), BenchmarkCase("ellipsoid", override=PLAIN_WHITE)),
    _textures,
)

MODULE = Study(
    "interaction",
    "With and without the interaction module",
    f"Long-term prediction of several balls. {LEGEND} T_train is 15, T_gen 30. {IMPACTS}",
    (BenchmarkCase("ellipsoid", 2), BenchmarkCase("ellipsoid", 3)),
    _modules,
)

COLLISIONS = Study(
    "collisions",
    "After the first collision",
    f"""Errors 5 and 10 steps after the first collision, on test scenes in which two balls collide.
Forecasts start ten steps before the collision. {LEGEND} {IMPACTS}""",
    (BenchmarkCase("ellipsoid", 2, colliding=True), BenchmarkCase("ellipsoid", 3, colliding=True)),
    _modules,
)

INTERPOLATION = Study(
    "interpolation",
    "Extrapolation and interpolation",
    f"""Forecasts from four frames compared with forecasts from four frames and a final frame.
"compact-dispnet trained to T" denotes four networks, each supervised up to its horizon. Committed
models that interpolate receive the frame of T_gen. {LEGEND}""",
    (
        *(
            BenchmarkCase(name, horizons=LENGTHS)
            for name in ("hemisphere", "ellipsoid", "heightfield")
        ),
        *(BenchmarkCase("ellipsoid", objects, horizons=LENGTHS[:3]) for objects in (2, 3)),
    ),
    _interpolation,
)

SUPERVISION = Study(
    "supervision",
    "Supervised up to 20 steps and up to 40",
    f"{LEGEND} T_train is 20, T_gen 40.",
    (BenchmarkCase("hemisphere"), BenchmarkCase("ellipsoid"), BenchmarkCase("heightfield")),
    _supervision,
)
