"""Results drawn over the frames that a user has."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from rollcast.client.images import Crop, Frames, each, pixels
from rollcast.plot import draw_forecast, draw_truth
from rollcast.trajectory import STEP_TOLERANCE

if TYPE_CHECKING:
    from rollcast.client.results import Forecast, Simulation


def forecast(
    forecast: "Forecast",
    frames: Frames,
    times_s: Sequence[float] | None,
    crop: Crop | None,
    panels: int,
) -> Image.Image:
    """Draw a forecast as ``Forecast.plot`` describes."""
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
    end_s = forecast.times_s[-1] + tolerance_s
    shown = _spread(sum(time_s <= end_s for time_s in times_s), panels)
    pictures = [pixels(frames[index], crop) for index in shown]
    for picture in pictures:
        height, width = picture.shape[:2]
        if (width, height) != tuple(forecast.frame_size):
            raise ValueError(
                f"a frame is {width} x {height}, the forecast is of frames of "
                f"{forecast.frame_size[0]} x {forecast.frame_size[1]}"
            )
    return draw_forecast(np.stack(pictures), np.array(times_s)[shown], forecast)


def simulation(simulation: "Simulation", panels: int) -> Image.Image:
    """Draw a true path as ``Simulation.plot`` describes."""
    if simulation.frames is None:
        raise ValueError("the simulation has no frames: it was asked for without them")
    shown = _spread(len(simulation.times_s), panels)
    return draw_truth(simulation.frames[shown], simulation.times_s[shown], simulation)


def _spread(frames: int, panels: int) -> list[int]:
    """Return the first frame and at most so many later ones, evenly spread up to the last."""
    wanted = np.linspace(0, frames - 1, min(frames, 1 + panels)).tolist()
    return sorted({round(index) for index in wanted})
