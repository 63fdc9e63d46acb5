"""Frames of the user's footage: a video, a folder of images, or images."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rollcast.clip import open_clip
from rollcast.commands.options import CommandError
from rollcast.errors import FootageEndedError
from rollcast.footage import (
    Footage,
    FrameSource,
    PictureCrop,
    rate_near,
    read_at,
    read_evenly,
)
from rollcast.image_sequence import ImageSequence
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

LaterFrames = Callable[[Sequence[float]], Footage]
"""Reader of frames at given times of the footage, in seconds, without times after its end."""


def read(
    paths: Sequence[Path],
    start_s: float | None,
    stride: int | None,
    rate: float | None,
    crop: PictureCrop | None,
    wanted_rate: float = FRAME_RATE_HZ,
    told_rates: tuple[float, float] | None = None,
) -> tuple[Footage, LaterFrames]:
    """Return the observed frames and a reader of later ones, both from one resampler.

    Parameters
    ----------
    wanted_rate
        Frame rate of the model, in Hz.
    told_rates
        As for :func:`rollcast.footage.read_evenly`.

    Raises
    ------
    CommandError
        If the options do not fit the footage.
    RollcastError
        When it cannot be read.
    """
    source = open_clip(paths, rate=rate, default_rate=wanted_rate)
    if isinstance(source, ImageSequence):
        if start_s is not None:
            raise CommandError("--start is for a video; of images the first four are observed")
        if len(source) < OBSERVED_FRAMES:
            raise CommandError(
                f"{len(source)} image{'s' * (len(source) != 1)}, expected a video, a folder or at "
                "least four images"
            )
    if stride is not None:
        wanted_rate = rate_near(source, start_s or 0.0) / stride
        observed = read_evenly(source, start_s=start_s or 0.0, crop=crop, frame_rate=wanted_rate)
    else:
        observed = _observed(source, start_s or 0.0, crop, wanted_rate, told_rates)

    def later_frames(times_s: Sequence[float]) -> Footage:
        return read_at(source, times_s, crop=crop, frame_rate=observed.frame_rate)

    return observed, later_frames


def frame_of_step(step: int, observed: Footage, later_frames: LaterFrames) -> np.ndarray:
    """Return the frame that shows a step of the forecast.

    Raises
    ------
    CommandError
        When the footage ends before it.
    """
    wanted_s = float(observed.times_s[-1]) + step / observed.frame_rate
    try:
        return later_frames([wanted_s]).frames[0]
    except FootageEndedError as error:
        raise CommandError(
            f"--final is {step}, whose frame lies {wanted_s:.2f} s after the start of the footage, "
            "which ends before"
        ) from error


def _observed(
    source: FrameSource,
    start_s: float,
    crop: PictureCrop | None,
    wanted_rate: float,
    told_rates: tuple[float, float] | None,
) -> Footage:
    """Return four frames at the model's rate if the images allow it."""
    try:
        return read_evenly(
            source, start_s=start_s, crop=crop, frame_rate=wanted_rate, told_rates=told_rates
        )
    except FootageEndedError:
        if not isinstance(source, ImageSequence) or source.rate <= wanted_rate:
            raise
        # Of faster images there are too few, and the service will say so.
        return read_evenly(source, crop=crop, frame_rate=source.rate)
