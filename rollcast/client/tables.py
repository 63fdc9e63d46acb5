"""Results as tables with a row for every step of every ball, in the order of time."""

import csv
import io
from typing import TYPE_CHECKING

import numpy as np

from rollcast.errors import MissingExtraError

if TYPE_CHECKING:
    from pandas import DataFrame

    from rollcast.client.results import Forecast, Simulation

Columns = dict[str, np.ndarray]
"""Names, which end in the unit, and values."""


def forecast_columns(forecast: "Forecast") -> Columns:
    """Return the columns of ``Forecast.to_dataframe``."""
    columns = _path_columns(forecast)
    covariances = _rows(forecast.covariances)
    columns |= {
        "xx_px2": covariances[:, 0, 0],
        "xy_px2": covariances[:, 0, 1],
        "yy_px2": covariances[:, 1, 1],
    }
    return columns | _turning_columns(forecast.angular_velocities) | _found_columns(forecast)


def simulation_columns(simulation: "Simulation") -> Columns:
    """Return the columns of ``Simulation.to_dataframe``."""
    return _path_columns(simulation) | _turning_columns(simulation.angular_velocities)


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


def _path_columns(result: "Forecast | Simulation") -> Columns:
    objects, steps = len(result.colors), len(result.times_s)
    positions = _rows(result.positions)
    return {
        "step": np.arange(steps).repeat(objects),
        "time_s": np.repeat(np.asarray(result.times_s), objects),
        "object": np.tile(np.arange(objects), steps),
        "color": np.array([*result.colors] * steps, object),
        "x_px": positions[:, 0],
        "y_px": positions[:, 1],
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


def _turning_columns(angular_velocities: np.ndarray | None) -> Columns:
    if angular_velocities is None:
        return {}
    return dict(zip(("wx_rad_s", "wy_rad_s", "wz_rad_s"), _rows(angular_velocities).T, strict=True))


def _rows(values: np.ndarray) -> np.ndarray:
    """Turn [objects, steps, ...] into one row for every object of every step."""
    return values.swapaxes(0, 1).reshape(-1, *values.shape[2:])
