"""Results as text: tables for people, JSON and CSV for programs."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from rollcast.client import Forecast, Simulation
from rollcast.client.files import paths, seen_balls
from rollcast.client.tables import Columns, csv_text, forecast_columns, simulation_columns
from rollcast.commands.options import Format
from rollcast.commands.overlay import spread
from rollcast.footage import Footage, PictureCrop, SquareCrop
from rollcast.outputs import Units, rescaled

TABLE_ROWS = 10


def forecast_text(
    observed: Footage, forecast: Forecast, warnings: Sequence[str], form: Format
) -> str:
    """Print a forecast in pixels of the uncropped picture; CSV has no place for warnings."""
    crop = observed.crop
    outputs = rescaled(forecast.outputs, Units(origin=(-crop.x, -crop.y)))
    columns = forecast_columns(replace(forecast, outputs=outputs))
    if form == "csv":
        return csv_text(columns)
    model = f"{forecast.model.name}@{forecast.model.version}"
    if form == "table":
        lines = [
            f"{model}: four frames from {observed.times_s[0]:.3f} s to "
            f"{observed.times_s[-1]:.3f} s ({observed.frame_rate:.3g} a second), {_shown(crop)}",
            "time_s: seconds after the last of these frames; x, y: pixels of the uncropped picture",
        ]
        warning_lines = [f"warning: {warning}" for warning in warnings]
        balls = _balls(forecast, crop)
        return "\n".join([*lines, *balls, *_path_table(columns), *warning_lines])
    return as_json(
        {
            "model": model,
            "frame_rate": forecast.frame_rate,
            "step_rate": forecast.step_rate,
            "crop": asdict(crop) if isinstance(crop, SquareCrop) else None,
            "observed_times_s": observed.times_s.tolist(),
            "times_s": forecast.times_s.tolist(),
            "ellipse50_radii": forecast.ellipse50_radii.tolist(),
            "objects": [
                {
                    "id": ball,
                    "color": color,
                    **paths(outputs, ball),
                    "covariance_source": forecast.covariance_source,
                    "score": None if forecast.scores is None else float(forecast.scores[ball]),
                    "seen": seen_balls(forecast, ball, crop.x, crop.y),
                    "warnings": forecast.object_warnings[ball],
                    "motion": forecast.motions[ball],
                }
                for ball, color in enumerate(forecast.colors)
            ],
            "warnings": list(warnings),
        }
    )


def ball_warnings(forecast: Forecast) -> list[str]:
    """Return the warnings of single balls, which name their ball where there are several."""
    several = len(forecast.object_warnings) > 1
    return [
        f"ball {ball}: {warning}" if several else warning
        for ball, warnings in enumerate(forecast.object_warnings)
        for warning in warnings
    ]


def truth_text(simulation: Simulation, form: Format) -> str:
    """Print a true path in pixels of the frames."""
    columns = simulation_columns(simulation)
    if form == "csv":
        return csv_text(columns)
    if form == "table":
        return "\n".join(
            [
                f"{simulation.scene.scenario}, seed {simulation.scene.seed}: "
                f"{len(simulation.times_s)} steps, {simulation.frame_rate:g} a second",
                "time_s: seconds after the first; x, y: pixels of the frames",
                *_path_table(columns),
            ]
        )
    return as_json(
        {
            "frame_rate": simulation.frame_rate,
            "frame_size": simulation.frame_size,
            "times_s": simulation.times_s.tolist(),
            "objects": [
                {
                    "id": ball,
                    "color": color,
                    "radius_px": float(simulation.radii_px[ball]),
                    "positions": simulation.positions[ball].tolist(),
                    "angular_velocities": simulation.angular_velocities[ball].tolist(),
                }
                for ball, color in enumerate(simulation.colors)
            ],
            "scene": simulation.scene.model_dump(mode="json"),
        }
    )


def as_json(value: object) -> str:
    """Return JSON to be read by people as well."""
    return json.dumps(value, indent=1)


def as_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return left-aligned columns; the keys of the first row are their names."""
    cells = [[*rows[0]], *[[str(value) for value in row.values()] for row in rows]]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )


def _shown(crop: PictureCrop) -> str:
    if isinstance(crop, SquareCrop):
        return f"crop {crop.x},{crop.y},{crop.size}"
    return "whole pictures"


def _balls(forecast: Forecast, crop: PictureCrop) -> list[str]:
    """Return position and confidence of each ball in the last observed frame."""
    if forecast.seen is None or forecast.scores is None:
        return []
    places = forecast.seen[:, -1] + (crop.x, crop.y, 0)
    return [
        f"ball {ball}: seen at {x:.1f}, {y:.1f}, radius {radius:.1f} px, score {score:.2f}"
        for ball, ((x, y, radius), score) in enumerate(
            zip(places.tolist(), forecast.scores.tolist(), strict=True)
        )
    ]


def _path_table(columns: Columns) -> list[str]:
    """Show some steps, evenly spread, of every ball."""
    balls = int(columns["object"].max()) + 1
    lines = [f"{'time_s':>7} {'ball':>4} {'x':>8} {'y':>8}"]
    for step in spread(len(columns["step"]) // balls, TABLE_ROWS):
        for row in range(balls * step, balls * (step + 1)):
            lines.append(
                f"{columns['time_s'][row]:7.3f} {columns['object'][row]:4} "
                f"{columns['x_px'][row]:8.1f} {columns['y_px'][row]:8.1f}"
            )
    return lines
