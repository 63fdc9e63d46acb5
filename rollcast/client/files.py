"""Forecasts as files: JSON, CSV, pictures and videos."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rollcast.client import pictures, tables
from rollcast.client.images import Crop, Frames
from rollcast.outputs import FORECAST_OUTPUTS, STEP_OUTPUTS, OutputName
from rollcast.schemas import ForecastObject, PredictResponse
from rollcast.video_writer import write_video

if TYPE_CHECKING:
    from rollcast.client.results import Forecast

PICTURES = (".png", ".jpg", ".jpeg", ".webp")
VIDEOS = (".mp4", ".webm", ".gif")
TEXTS = (".json", ".csv")


def save(
    forecast: "Forecast",
    path: Path,
    frames: Frames | None,
    times_s: Sequence[float] | None,
    crop: Crop | None,
) -> None:
    """Write a forecast as ``Forecast.save`` describes."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        path.write_text(forecast_json(forecast) + "\n", encoding="utf-8")
    elif suffix == ".csv":
        text = tables.csv_text(tables.forecast_columns(forecast))
        path.write_text(text + "\n", encoding="utf-8")
    elif suffix in PICTURES:
        pictures.forecast(forecast, frames, times_s, crop).save(path)
    elif suffix in VIDEOS:
        write_video(
            path, pictures.video_frames(forecast, frames, times_s, crop), forecast.step_rate
        )
    else:
        known = ", ".join((*PICTURES, *VIDEOS, *TEXTS))
        raise ValueError(f"{path} ends in {suffix!r}, expected one of {known}")


def forecast_json(forecast: "Forecast") -> str:
    """Return the body of the answer that a forecast was made of."""
    body = {
        **{
            name: getattr(forecast, name)
            for name in ("model", "frame_size", "frame_rate", "step_rate", "warnings", "timing_ms")
        },
        "objects": [
            ForecastObject.model_validate(
                {
                    "id": index,
                    "color": color,
                    **paths(forecast.outputs, index),
                    "covariance_source": forecast.covariance_source,
                    "score": None if forecast.scores is None else float(forecast.scores[index]),
                    "seen": seen_balls(forecast, index),
                    "warnings": forecast.object_warnings[index],
                    "motion": forecast.motions[index],
                    "alternative": forecast.alternatives[index],
                }
            )
            for index, color in enumerate(forecast.colors)
        ],
        "times_s": forecast.times_s.tolist(),
        "ellipse50_radii": forecast.ellipse50_radii.tolist(),
        **{
            spec.name: forecast.outputs[spec.name].tolist()
            if spec.name in forecast.outputs
            else None
            for spec in FORECAST_OUTPUTS
        },
    }
    return PredictResponse.model_validate(body).model_dump_json()


def paths(outputs: Mapping[OutputName, np.ndarray], index: int) -> dict[OutputName, Any]:
    """Return the outputs of one object at all steps as lists; None where it has none."""
    return {
        spec.name: None
        if spec.name not in outputs or np.isnan(outputs[spec.name][index]).any()
        else outputs[spec.name][index].tolist()
        for spec in STEP_OUTPUTS
    }


def seen_balls(
    forecast: "Forecast", index: int, x: float = 0, y: float = 0
) -> list[dict[str, float]] | None:
    """Return where an object was seen, moved by x and y pixels; None where that is not known."""
    if forecast.seen is None:
        return None
    rows: list[list[float]] = (forecast.seen[index] + (x, y, 0)).tolist()
    return [dict(zip(("x", "y", "radius"), row, strict=True)) for row in rows]


def png(forecast: "Forecast") -> bytes:
    """Return a picture of a forecast without frames as a PNG file."""
    buffer = io.BytesIO()
    pictures.forecast(forecast, None, None, None).save(buffer, "PNG")
    return buffer.getvalue()
