"""Results drawn over a user's frames."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from rollcast.client.images import Crop, Frames, each, pixels
from rollcast.plot import draw_forecast, draw_moment, draw_truth
from rollcast.trajectory import STEP_TOLERANCE

if TYPE_CHECKING:
    from rollcast.client.results import Forecast, Simulation

PANELS = 6
"""Number of later frames that a picture shows, at most."""
BACKGROUND = 40
"""Grey of a background without a frame."""


def forecast(
    forecast: "Forecast",
    frames: Frames | None,
    times_s: Sequence[float] | None,
    crop: Crop | None,
    panels: int = PANELS,
) -> Image.Image:
    """Draw a forecast as ``Forecast.plot`` describes."""
    frames, times_s = _timed(forecast, frames, times_s)
    end_s = forecast.times_s[-1] + STEP_TOLERANCE / forecast.step_rate
    shown = _spread(sum(time_s <= end_s for time_s in times_s), panels)
    drawn = [_fitting(forecast, frames, index, crop) for index in shown]
    return draw_forecast(
        np.stack(drawn), np.array(times_s)[shown], forecast, rings_of(forecast, -1)
    )


def video_frames(
    forecast: "Forecast",
    frames: Frames | None,
    times_s: Sequence[float] | None,
    crop: Crop | None,
) -> Iterator[Image.Image]:
    """Draw every step of a forecast over the latest frame that is not after it."""
    frames, times_s = _timed(forecast, frames, times_s)
    tolerance_s = STEP_TOLERANCE / forecast.step_rate
    latest, frame = 0, _fitting(forecast, frames, 0, crop)
    for time_s in forecast.times_s.tolist():
        index = sum(taken_s <= time_s + tolerance_s for taken_s in times_s) - 1
        if index > latest:
            latest, frame = index, _fitting(forecast, frames, index, crop)
        rings = rings_of(forecast, -1) if latest == 0 else None
        yield draw_moment(frame, time_s, forecast, f"+{time_s:.2f} s", rings)


def rings_of(forecast: "Forecast", index: int) -> np.ndarray | None:
    """Return where balls were seen in one observed frame, [objects, 3]; None when not known."""
    return None if forecast.seen is None else forecast.seen[:, index]


def simulation(simulation: "Simulation", panels: int) -> Image.Image:
    """Draw a true path as ``Simulation.plot`` describes."""
    if simulation.frames is None:
        raise ValueError("the simulation has no frames: include_frames was False")
    shown = _spread(len(simulation.times_s), panels)
    return draw_truth(simulation.frames[shown], simulation.times_s[shown], simulation)


def _timed(
    forecast: "Forecast", frames: Frames | None, times_s: Sequence[float] | None
) -> tuple[Frames, Sequence[float]]:
    """Return frames, by default a dark one, and when each of them was taken."""
    if frames is None:
        width, height = forecast.frame_size
        frames = np.full((1, height, width, 3), BACKGROUND, np.uint8)
    frames = each(frames)
    if times_s is None:
        times_s = [index / forecast.frame_rate for index in range(len(frames))]
    tolerance_s = STEP_TOLERANCE / forecast.frame_rate
    is_now = len(times_s) > 0 and abs(times_s[0]) <= tolerance_s
    if len(times_s) != len(frames) or not is_now or sorted(times_s) != list(times_s):
        raise ValueError(
            f"{len(frames)} frames at {list(times_s)} s, expected as many times, ascending from 0: "
            "the last observed frame"
        )
    return frames, times_s


def _fitting(forecast: "Forecast", frames: Frames, index: int, crop: Crop | None) -> np.ndarray:
    """Return the pixels of a frame of the forecast's size."""
    picture = pixels(frames[index], crop)
    height, width = picture.shape[:2]
    if (width, height) != tuple(forecast.frame_size):
        raise ValueError(
            f"a frame is {width} x {height}, the forecast is of frames of "
            f"{forecast.frame_size[0]} x {forecast.frame_size[1]}"
        )
    return picture


def _spread(frames: int, panels: int) -> list[int]:
    """Return the first frame and at most ``panels`` later ones, evenly spread up to the last."""
    wanted = np.linspace(0, frames - 1, min(frames, 1 + panels)).tolist()
    return sorted({round(index) for index in wanted})
