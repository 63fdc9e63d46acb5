"""Results as tables with a row for every step of every ball, in the order of time."""

import csv
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rollcast.errors import MissingExtraError
from rollcast.outputs import STEP_OUTPUTS, OutputName

if TYPE_CHECKING:
    from pandas import DataFrame

    from rollcast.client.results import Forecast, Simulation

Columns = dict[str, np.ndarray]
"""Columns of a table: names, which end in the unit, and values."""


def forecast_columns(forecast: "Forecast") -> Columns:
    """Return the columns of ``Forecast.to_dataframe``."""
    columns = _step_columns(forecast) | _output_columns(forecast.outputs)
    return columns | _found_columns(forecast)


def simulation_columns(simulation: "Simulation") -> Columns:
    """Return the columns of ``Simulation.to_dataframe``."""
    known = ("positions", "angular_velocities")
    outputs = {name: getattr(simulation, name) for name in known}
    return _step_columns(simulation) | _output_columns(outputs)


def dataframe(columns: Columns) -> "DataFrame":
    """Return columns as pandas has them.

    Raises
    ------
    MissingExtraError
        When pandas is not installed.
    """
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        raise MissingExtraError("data frames need", "pandas", "dataframe") from error
    return pd.DataFrame(columns)


def csv_text(columns: Columns) -> str:
    """Return a line of names and a line for every row, without the last line's end."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    return text.getvalue().rstrip("\n")


def _step_columns(result: "Forecast | Simulation") -> Columns:
    objects, steps = len(result.colors), len(result.times_s)
    return {
        "step": np.arange(steps).repeat(objects),
        "time_s": np.repeat(np.asarray(result.times_s), objects),
        "object": np.tile(np.arange(objects), steps),
        "color": np.array([*result.colors] * steps, object),
    }


def _output_columns(outputs: Mapping[OutputName, np.ndarray]) -> Columns:
    return {
        column: _rows(outputs[spec.name])[:, *index]
        for spec in STEP_OUTPUTS
        if spec.name in outputs
        for column, index in spec.columns.items()
    }


def _found_columns(forecast: "Forecast") -> Columns:
    if forecast.scores is None or forecast.seen is None:
        return {}
    steps = len(forecast.times_s)
    told = np.array([" ".join(warnings) for warnings in forecast.object_warnings], object)
    return {
        "radius_px": np.tile(forecast.seen[:, -1, 2], steps),
        "score": np.tile(forecast.scores, steps),
        "warnings": np.tile(told, steps),
    }


def _rows(values: np.ndarray) -> np.ndarray:
    """Turn [objects, steps, ...] into one row for every object of every step."""
    return values.swapaxes(0, 1).reshape(-1, *values.shape[2:])
