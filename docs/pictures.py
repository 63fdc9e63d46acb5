"""``python -m docs.pictures``: the guide's pictures, from the simulator and the committed models.

Needs the environment of the tests (`.venv/test`). Every picture is written to ``docs/images``.
"""

import argparse
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from PIL import Image

from docs.drawing import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    STYLE,
    arrow,
    box,
    ellipse,
    show,
    write,
)  # fmt: skip
from docs.physics import contact, energy
from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.plot import PALETTE, draw_forecast
from rollcast.rollout import roll_out
from rollcast.scene import SCENARIOS, Scenario
from rollcast.simulation import Sequence, Simulator
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES
from service.inference.rollout import Predictor, assemble
from service.serving.loading import load_registry
from service.serving.registry import ModelQuery
from training.data.rest_height_map import resting_ground

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs/images"
STEPS = 40
HERO_FRAME_PX, HERO_PX = 360, (1050, 420)
"""Of the first picture, whose many edges would be large without a palette."""


def main() -> None:
    """Draw the pictures that are named, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m docs.pictures", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PICTURES)}")
    names = parser.parse_args().names or list(PICTURES)
    if unknown := sorted(set(names) - PICTURES.keys()):
        parser.error(f"no such pictures: {', '.join(unknown)}")
    for name in names:
        with mpl.rc_context(STYLE):
            path = IMAGES / f"{name}.png"
            write(PICTURES[name](), path)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")


def forecast() -> Image.Image:
    """Draw a forecast as ``rollcast predict`` does, over the frames that followed."""
    predictor = _predictor(ModelQuery())
    sequence = _sequence("ellipsoid", 1, 7, start_step=160)
    seen = sequence.render(NETWORK_FRAME_SIZE)[None, :OBSERVED_FRAMES]
    made = assemble(roll_out(predictor, seen, STEPS), predictor.manifest.covariance)
    made = made.rescaled(HERO_FRAME_PX / NETWORK_FRAME_SIZE, 1)
    shown = np.linspace(0, STEPS - 1, 7).round().astype(int)
    times_s = np.arange(STEPS) / FRAME_RATE_HZ
    path = SimpleNamespace(
        positions=made.positions[0], covariances=made.covariances[0], times_s=times_s
    )
    frames = sequence.render(HERO_FRAME_PX)[OBSERVED_FRAMES - 1 :]
    sheet = draw_forecast(frames[shown], times_s[shown], path)
    return sheet.resize(HERO_PX, Image.Resampling.LANCZOS).quantize(
        256, kmeans=4, dither=Image.Dither.NONE
    )


def scenarios() -> Figure:
    """Draw each scenario from above, with the way that its balls take in the next second."""
    figure = Figure(figsize=(7.4, 2.75), layout="constrained")
    shown = [("hemisphere", 1, 14), ("ellipsoid", 3, 4), ("heightfield", 1, 22)]
    for axes, (scenario, objects, seed) in zip(figure.subplots(1, 3), shown, strict=True):
        scene = _sequence(scenario, objects, seed)
        show(axes, scene.render(384)[OBSERVED_FRAMES - 1])
        for ball, way in enumerate(_pixels(scene, 384)):
            color = "white" if objects == 1 else PALETTE[ball]
            ahead = way[OBSERVED_FRAMES - 1 :]
            axes.plot(*ahead.T, color="black", linewidth=3.2, alpha=0.6)
            axes.plot(*ahead.T, color=color, linewidth=1.6)
            axes.plot(*ahead[10::10].T, "o", color=color, markersize=4, markeredgecolor="black")
        balls = "1 ball" if objects == 1 else f"{objects} balls"
        axes.set_title(f"{scenario}, {balls}")
    return figure


def conventions() -> Figure:
    """Draw a frame with the image's and the world's axes, and the time line under it."""
    figure = Figure(figsize=(8.4, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.35))
    scene = _sequence("hemisphere", 1, 12)
    show(left, scene.render(128)[OBSERVED_FRAMES - 1])
    place = _pixels(scene, 128)[0, OBSERVED_FRAMES - 1]
    outlined = [patheffects.withStroke(linewidth=3, foreground="black")]
    left.set_title("a frame of 128 x 128 pixels", pad=16)
    straight = {"arrowstyle": "-|>", "mutation_scale": 13, "linewidth": 2, "clip_on": False}
    for (x, y), name in (((34, 0), "x, pixels"), ((0, 34), "y, pixels")):
        left.add_patch(FancyArrowPatch((0, 0), (x, y), color=ORANGE, **straight))
        at = (x + 3, 3) if x else (2, y + 6)
        left.text(*at, name, color=ORANGE, weight="bold", va="center", path_effects=outlined)
    for (x, y), name in (((94, 64), "world x"), ((64, 34), "world y")):
        left.add_patch(FancyArrowPatch((64, 64), (x, y), color=BLUE, **straight))
        at = (x + 2, y + 8) if x > 64 else (x + 4, y + 2)
        left.text(*at, name, color=BLUE, weight="bold", va="center", path_effects=outlined)
    left.plot(*place, "o", color="white", markersize=6, markeredgecolor="black")
    left.annotate(
        f"({place[0]:.1f}, {place[1]:.1f})", tuple(place), (10, -10), color="white",
        textcoords="offset points", weight="bold", path_effects=outlined,
    )  # fmt: skip
    right.set(xlim=(-3.8, 9.4), ylim=(-2.4, 2.2))
    right.axis("off")
    right.plot([-3.4, 9], [0, 0], color=GREY, linewidth=1)
    for step in range(-3, 9):
        seen = step <= 0
        right.plot(step, 0, "s" if seen else "o", color=ORANGE if seen else BLUE, markersize=9)
        right.text(step, -0.42, str(step), ha="center", va="top")
    right.text(-4.0, -0.42, "t =", ha="right", va="top")
    right.text(-1.5, 0.5, "four frames seen", color=ORANGE, ha="center", weight="bold")
    right.annotate("", (-3.2, 0.4), (0.2, 0.4), arrowprops={"arrowstyle": "-", "color": ORANGE})
    right.text(4.6, 1.25, "forecast of horizon T: t = 0 .. T-1", color=BLUE, ha="center",
               weight="bold")  # fmt: skip
    right.annotate("", (-0.2, 1.15), (8.9, 1.15), arrowprops={"arrowstyle": "<-", "color": BLUE})
    right.text(
        2.6, -1.55,
        "positions[ball, t]: pixels of the frames that were sent\n"
        "times_s[t] = t / frame rate: t = 0 is the last observed frame",
        ha="center", va="center",
    )  # fmt: skip
    right.set_title("steps, 40 a second")
    return figure


def ground() -> Figure:
    """Draw the ground map of FieldNet's perception beside the true one."""
    predictor = _predictor(ModelQuery("fieldnet"))
    figure = Figure(figsize=(8.4, 4.9), layout="constrained")
    rows = figure.subplots(2, 3)
    for row, (scenario, seed) in zip(rows, (("ellipsoid", 3), ("heightfield", 28)), strict=True):
        scene = _sequence(scenario, 1, seed)
        frames = scene.render(NETWORK_FRAME_SIZE)
        half_cm = 100 * camera_for(scenario, NETWORK_FRAME_SIZE).half_width_m
        true = half_cm * resting_ground(scene.scene)[2]
        state = predictor.encode(frames[None, :OBSERVED_FRAMES]).state
        read = np.where(np.isnan(true), np.nan, half_cm * state["s"][0, 2])
        show(row[0], frames[OBSERVED_FRAMES - 1])
        low, high = np.nanmin(true), np.nanmax(true)
        for axes, values in ((row[1], true), (row[2], read)):
            drawn = axes.imshow(values, cmap="cividis", vmin=low, vmax=high)
            axes.set(xticks=[], yticks=[])
            axes.set_facecolor(PALE)
            axes.spines[:].set_visible(False)
        figure.colorbar(drawn, ax=list(row[1:]), label="height, cm", shrink=0.9)
        off = np.nanmean(np.abs(read - true))
        row[2].set_xlabel(f"mean error {off:.1f} cm")
        row[0].set_ylabel(scenario)
    for axes, name in zip(
        rows[0], ("last observed frame", "true ground", "estimate of the perception"), strict=True
    ):
        axes.set_title(name)
    return figure


def uncertainty() -> Figure:
    """Draw forecasts of "auto" with their ellipses over the last observed frame, and the truth."""
    predictor = _predictor(ModelQuery())
    figure = Figure(figsize=(8.0, 2.75), layout="constrained")
    shown = [("hemisphere", 16), ("ellipsoid", 3), ("heightfield", 15), ("heightfield", 35)]
    for axes, (scenario, seed) in zip(figure.subplots(1, 4), shown, strict=True):
        scene = _sequence(scenario, 1, seed)
        frames = scene.render(NETWORK_FRAME_SIZE)[:OBSERVED_FRAMES]
        forecast = assemble(roll_out(predictor, frames[None], STEPS), predictor.manifest.covariance)
        truth = _pixels(scene, NETWORK_FRAME_SIZE)[0, OBSERVED_FRAMES - 1 :]
        way, covariances = forecast.positions[0, 0], forecast.covariances[0, 0]
        show(axes, frames[-1])
        for step in range(4, STEPS, 5):
            axes.add_patch(ellipse(way[step], covariances[step], BLUE))
        axes.plot(*truth.T, color="white", linewidth=2.4)
        axes.plot(*way.T, color=BLUE, linewidth=1.5)
        axes.plot(*truth[-1], "o", color="white", markersize=6, markeredgecolor="black")
        axes.plot(*way[-1], "X", color=BLUE, markersize=7, markeredgecolor="black")
        off = math.dist(way[-1], truth[-1])
        axes.set_title(scenario)
        axes.set_xlabel(f"off by {off:.1f} px at T = {STEPS}")
    figure.supxlabel(
        f"white: truth, blue: {predictor.manifest.label} with ellipses of two standard deviations "
        "every eighth of a second", fontsize=9,
    )  # fmt: skip
    return figure


def step() -> Figure:
    """Draw the way of one forecast through the networks: encoder, step, read-outs."""
    figure = Figure(figsize=(8.4, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0, 16.8), ylim=(0, 7))
    axes.set_aspect("equal")
    axes.axis("off")
    frames = _sequence("hemisphere", 1, 12).render(128)[:OBSERVED_FRAMES]
    for index, frame in enumerate(frames):
        x, y = 0.2 + 0.3 * index, 3.1 - 0.25 * index
        axes.imshow(frame, extent=(x, x + 1.7, y, y + 1.7), zorder=2 + index)
    axes.text(1.5, 5.35, "4 frames\nt = -3 .. 0", ha="center", va="center")
    axes.set(xlim=(0, 16.8), ylim=(0, 7))
    box(axes, 3.7, 2.7, 2.1, 1.6, "encoder", ORANGE)
    states = (7.0, 10.6, 14.2)
    for index, x in enumerate(states):
        name = ("$h_0$", "$h_1$", "$h_2$")[index]
        box(axes, x, 2.7, 1.4, 1.6, f"{name}", BLUE, size=13)
        box(axes, x - 0.15, 5.0, 1.7, 0.9, "read-out", GREEN)
        arrow(axes, (x + 0.7, 4.3), (x + 0.7, 5.0))
        axes.text(x + 0.7, 6.35, ("$y_0$", "$y_1$", "$y_2$")[index], ha="center", va="center",
                  size=13)  # fmt: skip
    arrow(axes, (2.9, 3.5), (3.7, 3.5))
    arrow(axes, (5.8, 3.5), (7.0, 3.5))
    for left, right in zip(states, (*states[1:], 17.2), strict=True):
        middle = (left + 1.4 + min(right, 16.6)) / 2
        if right < 17:
            box(axes, middle - 0.75, 3.05, 1.5, 0.9, "step", PURPLE)
            arrow(axes, (left + 1.4, 3.5), (middle - 0.75, 3.5))
            arrow(axes, (middle + 0.75, 3.5), (right, 3.5))
    arrow(axes, (15.6, 3.5), (16.5, 3.5))
    axes.text(
        7.0, 1.55,
        "$h_t = (s_t, p_t)$: what is known of every place, and of every ball's motion",
        va="center",
    )  # fmt: skip
    axes.text(
        7.0, 0.75,
        "$y_t$: position, covariance, angular velocity of every ball at step t",
        va="center",
    )  # fmt: skip
    return figure


PICTURES: Mapping[str, Callable[[], Figure | Image.Image]] = {
    "forecast": forecast,
    "scenarios": scenarios,
    "conventions": conventions,
    "contact": contact,
    "energy": energy,
    "ground": ground,
    "uncertainty": uncertainty,
    "step": step,
}


def _sequence(
    scenario: Scenario, objects: int, seed: int, start_step: int | None = None
) -> Sequence:
    """Return the seen frames of a scene and the second after them."""
    assert scenario in SCENARIOS
    simulator = Simulator()
    try:
        return simulator.sequence(scenario, objects, seed, OBSERVED_FRAMES - 1 + STEPS, start_step)
    finally:
        simulator.close()


def _pixels(sequence: Sequence, image_size: int) -> np.ndarray:
    """Return positions [objects, frames, 2] in a frame."""
    camera = camera_for(sequence.scene.scenario, image_size)
    return camera.project(sequence.trajectory.positions_m).transpose(1, 0, 2)


def _predictor(query: ModelQuery) -> Predictor:
    return load_registry(ROOT / "models", "fieldnet").choose(query)


if __name__ == "__main__":
    main()
