"""Pictures (matplotlib): errors over time, calibration, ellipses over frames, a run's curves."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch
from matplotlib.ticker import LogFormatter
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from rollcast.plot import PALETTE
from rollcast.scene import SCENARIOS
from rollcast.trajectory import FRAME_RATE_HZ
from training.common.run_folder import EVENTS, LOSS
from training.data.windows import Window
from training.evaluation.paper import CONSTANT_POSITION, LINEAR_EXTRAPOLATION
from training.objectives.metrics import Forecasts
from training.reporting.markdown import title
from training.reporting.results import LEVELS, Curve, Measurement, Results

SIGMAS = 2.0
"""Size of the drawn ellipses, standard deviations."""
_STYLE: dict[Any, Any] = {
    "figure.dpi": 110,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
_LINES = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)))
"""Styles that tell methods apart once the colours are used up."""
_MOST_INSIDE = 10
"""Methods whose names have room inside a picture."""
_GROUP_WIDTH = 0.8
"""Width of all bars of a method; the distance between methods is 1."""
_LEAST_PX = 0.05
"""Lower end of the error axis; errors of 0 lie below it."""
_SMOOTHED = 9
"""Losses that a point of a training's curve is the median of."""
_BASELINE_STYLES = {CONSTANT_POSITION: ":", LINEAR_EXTRAPOLATION: "--"}


def draw_errors(curves: Sequence[Curve], path: Path) -> None:
    """Draw the median error of every method over time with its quartiles, one group."""
    with mpl.rc_context(_STYLE):
        beside = len(curves) > _MOST_INSIDE
        figure = Figure(figsize=(9, 5) if beside else (6.4, 3.4), layout="constrained")
        axes = figure.subplots()
        group = curves[0]
        methods = [curve.method for curve in curves if curve.method not in _BASELINE_STYLES]
        for curve in curves:
            low, middle, high = curve.quartiles_px
            steps = np.arange(1, len(middle) + 1)
            baseline = _BASELINE_STYLES.get(curve.method)
            if baseline:
                axes.plot(steps, middle, baseline, color="#666666", label=curve.method)
                continue
            style, color = _style(methods.index(curve.method))
            axes.plot(steps, middle, linestyle=style, color=color, label=curve.method)
            shade = 0.05 if beside else 0.15
            axes.fill_between(steps, low, high, color=color, alpha=shade, linewidth=0)
        trained = {c.trained_horizon for c in curves if c.trained_horizon is not None}
        for horizon in trained:
            axes.axvline(horizon, color="#bbbbbb", linewidth=1, zorder=0)
        axes.set(
            xlabel=f"T (steps of 1/{FRAME_RATE_HZ} s)", ylabel="position error, px", yscale="log",
            title=f"{title(group.scenario, group.objects, group.condition)}: median and quartiles",
        )  # fmt: skip
        axes.set_ylim(bottom=max(_LEAST_PX, axes.get_ylim()[0]))
        if beside:
            axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
        else:
            axes.legend(frameon=False, ncols=2)
        figure.savefig(path, metadata={"Software": None})


def draw_bars(results: Results, given_states: Mapping[str, bool], path: Path) -> None:
    """Draw a study's errors as bars, a panel a group.

    Parameters
    ----------
    given_states
        Methods in the order of the table; methods with true states as inputs are hatched.
    """
    groups = sorted({(c.objects, SCENARIOS.index(c.scenario), c.condition) for c in results.cells})
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9, 4 * len(groups)), layout="constrained")
        panels = figure.subplots(len(groups), 1, squeeze=False)[:, 0]
        for axes, (objects, index, condition) in zip(panels, groups, strict=True):
            group = (objects, SCENARIOS[index], condition)
            cells = [c for c in results.cells if (c.objects, c.scenario, c.condition) == group]
            draw_group(axes, cells, given_states)
            axes.set_title(title(SCENARIOS[index], objects, condition))
        figure.savefig(path, metadata={"Software": None})


def draw_group(axes: Axes, cells: Sequence[Measurement], given_states: Mapping[str, bool]) -> None:
    """Draw the methods that have been measured on a group, a bar a moment, side by side."""
    measured = {cell.method for cell in cells}
    methods = [method for method in given_states if method in measured]
    moments = list(dict.fromkeys(cell.at for cell in cells))
    width = _GROUP_WIDTH / len(moments)
    for cell in cells:
        moment = moments.index(cell.at)
        place = methods.index(cell.method) + width * (moment - (len(moments) - 1) / 2)
        axes.bar(
            place, cell.position_error_px, width, yerr=cell.standard_error_px,
            color=PALETTE[moment], edgecolor="white",
            hatch="///" if given_states[cell.method] else None,
        )  # fmt: skip
        if cell.paper_px is not None:
            ends = [place - width / 2, place + width / 2]
            axes.plot(ends, [cell.paper_px] * 2, "k-", linewidth=2)
    named = [
        *(Patch(color=PALETTE[place], label=at) for place, at in enumerate(moments)),
        Line2D([], [], color="black", linewidth=2, label="the paper's"),
    ]
    axes.set(ylabel="position error, px", yscale="log", ylim=(0.3, 300))
    axes.set_xticks(range(len(methods)), methods, rotation=30, ha="right", rotation_mode="anchor")
    axes.yaxis.set_major_formatter(LogFormatter())
    axes.legend(handles=named, frameon=False, ncols=len(named), loc="upper right")


def draw_conditions(results: Results, path: Path) -> None:
    """Draw the errors at both horizons by condition of the scenes, for every scenario."""
    groups = sorted({(cell.objects, SCENARIOS.index(cell.scenario)) for cell in results.cells})
    methods = list(dict.fromkeys(cell.method for cell in results.cells))
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9, 3.4 * len(groups)), layout="constrained")
        panels = figure.subplots(len(groups), 2, squeeze=False)
        for row, (objects, index) in zip(panels, groups, strict=True):
            scenario = SCENARIOS[index]
            cells = [c for c in results.cells if (c.objects, c.scenario) == (objects, scenario)]
            conditions = list(dict.fromkeys(cell.condition for cell in cells))
            for axes, at in zip(row, dict.fromkeys(cell.at for cell in cells), strict=True):
                for place, method in enumerate(methods):
                    own = [cell for cell in cells if (cell.method, cell.at) == (method, at)]
                    color = "#666666" if method in _BASELINE_STYLES else _style(place)[1]
                    axes.errorbar(
                        [conditions.index(cell.condition) for cell in own],
                        [cell.position_error_px for cell in own],
                        [cell.standard_error_px for cell in own],
                        fmt=_BASELINE_STYLES.get(method, "-") + "o", color=color, label=method,
                    )  # fmt: skip
                names = [name or "usual scenes" for name in conditions]
                axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
                axes.set(yscale="log", title=f"{title(scenario, objects)}, {at}")
                # Plain numbers instead of powers of ten: errors may span less than a decade.
                axes.yaxis.set_major_formatter(LogFormatter())
                axes.yaxis.set_minor_formatter(LogFormatter())
            row[0].set(ylabel="position error, px")
        named = panels[0, 0].get_legend_handles_labels()
        figure.legend(*named, frameon=False, ncols=len(methods), loc="outside upper center")
        figure.savefig(path, metadata={"Software": None})


def draw_training(folder: Path, path: Path) -> None:
    """Draw the curves of a run: its training loss, smoothed, and its validation errors.

    Parameters
    ----------
    folder
        The run's, with TensorBoard's events.
    """
    events = EventAccumulator(str(folder / EVENTS))
    events.Reload()
    tags: list[str] = events.Tags()["scalars"]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(8, 5.2), layout="constrained")
        upper, lower = figure.subplots(2, sharex=True)
        for tag in tags:
            axes = upper if tag == LOSS else lower
            points = events.Scalars(tag)
            seen = [point.step for point in points]
            values = np.array([point.value for point in points])
            marked = {} if len(values) > _SMOOTHED else {"marker": "."}
            axes.plot(seen, _running_median(values) if tag == LOSS else values, **marked, label=tag)
        upper.set(ylabel="training loss", yscale="log", title=folder.name)
        lower.set(xlabel="sequences", ylabel="validation error, px", yscale="log")
        for axes in (upper, lower):
            # Plain numbers instead of powers of ten: a curve may span less than a decade.
            axes.yaxis.set_major_formatter(LogFormatter())
            axes.yaxis.set_minor_formatter(LogFormatter())
        lower.legend(frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
        figure.savefig(path, metadata={"Software": None})


def _running_median(values: np.ndarray) -> np.ndarray:
    """Every value's median with those around it."""
    half = _SMOOTHED // 2
    return np.array(
        [np.median(values[max(k - half, 0) : k + half + 1]) for k in range(len(values))]
    )


def _style(index: int) -> tuple[Any, str]:
    """Line style and colour of a method."""
    rounds, place = divmod(index, len(PALETTE))
    return _LINES[rounds], PALETTE[place]


def draw_calibration(curves: Sequence[Curve], path: Path) -> None:
    """Draw how many truths lie inside the ellipses that should hold a share of them."""
    with mpl.rc_context(_STYLE):
        measured = [curve for curve in curves if curve.coverage is not None]
        scenarios = [name for name in SCENARIOS if any(c.scenario == name for c in measured)]
        methods = sorted({curve.method for curve in measured})
        figure = Figure(figsize=(9, 3.9), layout="constrained")
        panels = figure.subplots(1, len(scenarios), squeeze=False, sharey=True)[0]
        for axes, scenario in zip(panels, scenarios, strict=True):
            axes.plot([0, 1], [0, 1], color="#bbbbbb", linewidth=1)
            for curve in measured:
                if curve.scenario == scenario:
                    assert curve.coverage is not None
                    style, color = _style(methods.index(curve.method))
                    axes.plot(
                        LEVELS, curve.coverage, linestyle=style, color=color, label=curve.method
                    )
            axes.set(xlabel="share that the ellipse should hold", xlim=(0, 1), ylim=(0, 1))
            axes.set_title(scenario)
        panels[0].set_ylabel("share of truths inside")
        drawn = [axes.get_legend_handles_labels() for axes in panels]
        lines = {name: line for parts in drawn for line, name in zip(*parts, strict=True)}
        names = [name for name in methods if name in lines]
        figure.legend(
            [lines[name] for name in names], names, loc="outside right upper", frameon=False,
            fontsize=7,
        )  # fmt: skip
        figure.suptitle("Calibration over all steps up to the trained horizon", fontsize=10)
        figure.savefig(path, metadata={"Software": None})


def draw_ellipses(
    examples: Sequence[tuple[str, Window, Forecasts]], every: int, path: Path
) -> None:
    """Draw forecasts over the last seen frame: ellipses, forecast and true paths; three a row.

    Parameters
    ----------
    examples
        Caption, window, and forecasts of that window alone.
    every
        Steps between ellipses.
    """
    with mpl.rc_context(_STYLE):
        rows = math.ceil(len(examples) / 3)
        figure = Figure(figsize=(7.8, 2.9 * rows), layout="constrained")
        places = figure.subplots(rows, 3, squeeze=False).flat
        for (caption, window, made), axes in zip(examples, places, strict=False):
            size = window.frames.shape[1]
            axes.imshow(window.frames[3], extent=(0, size, size, 0))
            for ball in range(made.positions.shape[1]):
                color = PALETTE[ball]
                path_px, truth = made.positions[0, ball], made.true_positions[0, ball]
                axes.plot(*truth.T, color="white", linewidth=1.5)
                axes.plot(*path_px.T, color=color, linewidth=1.5)
                if made.covariances is not None:
                    for step in range(every - 1, len(path_px), every):
                        axes.add_patch(
                            _ellipse(path_px[step], made.covariances[0, ball, step], color)
                        )
            axes.set(xlim=(0, size), ylim=(size, 0), xticks=[], yticks=[], title=caption)
        for unused in places:
            unused.axis("off")
        figure.savefig(path, metadata={"Software": None})


def _ellipse(centre: np.ndarray, covariance: np.ndarray, color: str) -> Ellipse:
    variances, axes = np.linalg.eigh(covariance)
    width, height = 2 * SIGMAS * np.sqrt(variances)
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    return Ellipse(
        (float(centre[0]), float(centre[1])), float(width), float(height), angle=angle,
        fill=False, color=color, linewidth=1,
    )  # fmt: skip
