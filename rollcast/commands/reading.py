"""Frames of what a user names: a video, a folder of images, or images."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rollcast.commands.options import CommandError
from rollcast.errors import FootageError, MissingExtraError
from rollcast.footage import RATE_TOLERANCE, Footage, SquareCrop, read_images
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})
LaterFrames = Callable[[Sequence[float]], Footage]
"""Reads the frames nearest to some times of the footage, seconds; those after its end are left
out."""


def read(
    paths: Sequence[Path],
    start_s: float | None,
    every: int | None,
    rate: float | None,
    crop: SquareCrop | None,
    wanted_rate: float = FRAME_RATE_HZ,
) -> tuple[Footage, LaterFrames]:
    """Return the observed frames and what reads later ones.

    Parameters
    ----------
    wanted_rate
        Frames a second that the model knows.

    Raises
    ------
    CommandError
        When the options do not fit what was named.
    RollcastError
        When it cannot be read.
    """
    if len(paths) == 1 and not paths[0].is_dir():
        if rate is not None:
            raise CommandError("--rate is for images; a video tells its own")
        return _read_video(paths[0], start_s or 0.0, every, crop, wanted_rate)
    if start_s is not None:
        raise CommandError("--start is for a video; of images the first four are observed")
    images = _images_in(paths[0]) if len(paths) == 1 else paths
    rate = (rate or wanted_rate) / (every or 1)
    return _read_images(images[::every], rate, crop, rate if every else wanted_rate)


def frame_of_step(step: int, observed: Footage, later_frames: LaterFrames) -> np.ndarray:
    """Return the frame that shows a step of the forecast.

    Raises
    ------
    CommandError
        When the footage ends before it.
    """
    wanted_s = float(observed.times_s[-1]) + step / observed.frame_rate
    try:
        found = later_frames([wanted_s])
    except FootageError:  # a video that ends before
        found = None
    half_a_step_s = 0.5 / observed.frame_rate
    if found is None or not len(found.times_s) or found.times_s[0] < wanted_s - half_a_step_s:
        raise CommandError(
            f"--final is {step}, whose frame lies {wanted_s:.2f} s after the start of the footage, "
            "which ends before"
        )
    return found.frames[0]


def _read_video(
    path: Path, start_s: float, every: int | None, crop: SquareCrop | None, wanted_rate: float
) -> tuple[Footage, LaterFrames]:
    try:
        from rollcast.video import camera_rate, frames_at, read_frames
    except ModuleNotFoundError as error:
        raise MissingExtraError("videos need", "PyAV", "video") from error
    rate = wanted_rate if every is None else camera_rate(path, start_s) / every
    observed = read_frames(path, start_s=start_s, crop=crop, frame_rate=rate)
    return observed, lambda times_s: frames_at(path, times_s, crop=crop)


def _read_images(
    paths: Sequence[Path], rate: float, crop: SquareCrop | None, wanted_rate: float
) -> tuple[Footage, LaterFrames]:
    if len(paths) < OBSERVED_FRAMES:
        raise CommandError(
            f"{len(paths)} images, expected a video, a folder or at least four images"
        )
    footage = read_images(paths, crop=crop, frame_rate=rate)

    def later_frames(times_s: Sequence[float]) -> Footage:
        indices = [round(time_s * rate) for time_s in times_s]
        return footage.part([index for index in indices if index < len(paths)])

    return _observed(footage, wanted_rate), later_frames


def _observed(footage: Footage, wanted_rate: float) -> Footage:
    """Return four frames, as far apart as the model knows them where the images allow it."""
    first = footage.part(slice(OBSERVED_FRAMES))
    if abs(first.frame_rate / wanted_rate - 1) <= RATE_TOLERANCE:
        return first
    try:
        return footage.resampled(wanted_rate, OBSERVED_FRAMES)
    except FootageError:  # of faster ones there are too few, and the service will say so
        return first


def _images_in(folder: Path) -> list[Path]:
    """Return the images of a folder; frame10 comes after frame9."""
    images = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    return sorted(
        images,
        key=lambda path: [
            (int(part), "") if part.isdigit() else (-1, part)
            for part in re.split(r"([0-9]+)", path.name)
        ],
    )
