"""A forecast drawn over the footage: one picture, or frame by frame."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from rollcast.client import Forecast
from rollcast.client.pictures import rings_of
from rollcast.commands.options import VIDEOS
from rollcast.commands.progress import counted, waiting
from rollcast.commands.reading import LaterFrames
from rollcast.errors import FootageEndedError
from rollcast.footage import Footage
from rollcast.plot import draw_forecast, draw_moment
from rollcast.trajectory import STEP_TOLERANCE
from rollcast.video_writer import write_video

LATER_FRAMES = 6
"""Number of frames in the picture if footage follows the observed frames."""
FRAMES_AT_ONCE = 40
"""Number of frames that are held in memory while a video is written."""


def draw(
    path: Path,
    observed: Footage,
    later_frames: LaterFrames,
    forecast: Forecast,
    slowdown: int,
    said: str,
) -> None:
    """Write a picture or a video, depending on the suffix of the file, and print the stages."""
    if path.suffix.lower() in VIDEOS:
        steps = len(observed.frames) - 1 + len(forecast.times_s)
        moments = counted(_moments(observed, later_frames, forecast), steps, said)
        write_video(path, moments, forecast.step_rate / slowdown)
    else:
        with waiting(said):
            _picture(observed, later_frames, forecast).save(path)


def spread(steps: int, count: int) -> list[int]:
    """Return at most ``count`` steps from the first to the last, evenly spread."""
    return sorted({round(step) for step in np.linspace(0, steps - 1, min(steps, count)).tolist()})


def _picture(observed: Footage, later_frames: LaterFrames, forecast: Forecast) -> Image.Image:
    now_s = observed.times_s[-1]
    wanted_s = now_s + forecast.times_s[spread(len(forecast.times_s), LATER_FRAMES + 1)]
    shown = later_frames(wanted_s.tolist())
    return draw_forecast(shown.frames, shown.times_s - now_s, forecast, rings_of(forecast, -1))


def _moments(
    observed: Footage, later_frames: LaterFrames, forecast: Forecast
) -> Iterator[Image.Image]:
    """Draw the observed frames, then the forecast over the later frames."""
    now_s = float(observed.times_s[-1])
    taken = zip(observed.frames[:-1], observed.times_s[:-1].tolist(), strict=True)
    for index, (frame, taken_s) in enumerate(taken):
        title = f"{taken_s - now_s:+.2f} s, seen"
        yield draw_moment(frame, taken_s - now_s, forecast, title, rings_of(forecast, index))
    last = observed.frames[-1]
    for first in range(0, len(forecast.times_s), FRAMES_AT_ONCE):
        times_s: list[float] = forecast.times_s[first : first + FRAMES_AT_ONCE].tolist()
        shown = _shown(later_frames, [now_s + time_s for time_s in times_s])
        for time_s in times_s:
            title = f"+{time_s:.2f} s"
            frame = _frame_at(shown, now_s + time_s, STEP_TOLERANCE / forecast.step_rate)
            if frame is None:
                title += ", the footage has ended"
            else:
                last = frame
            rings = rings_of(forecast, -1) if time_s == 0 else None
            yield draw_moment(last, time_s, forecast, title, rings)


def _shown(later_frames: LaterFrames, wanted_s: Sequence[float]) -> Footage | None:
    try:
        return later_frames(wanted_s)
    except FootageEndedError:  # before the first of them
        return None


def _frame_at(footage: Footage | None, time_s: float, tolerance_s: float) -> np.ndarray | None:
    if footage is None or not len(footage.times_s) or time_s > footage.times_s[-1] + tolerance_s:
        return None
    return footage.frames[int(np.abs(footage.times_s - time_s).argmin())]
