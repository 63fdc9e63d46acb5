"""Footage of any kind becomes a source of frames: the content decides, not the name."""

import os
from collections.abc import Sequence
from pathlib import Path

from rollcast.errors import FootageError, MissingExtraError
from rollcast.footage import FrameSource
from rollcast.frames import shown_path
from rollcast.image_sequence import ImageSequence, is_single_picture, is_tiff
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES


def open_clip(
    path: Path | Sequence[Path], *, rate: float | None = None, default_rate: float = FRAME_RATE_HZ
) -> FrameSource:
    """Open a video, a folder of images, a TIFF file of several pages, or images in order.

    Parameters
    ----------
    path
        One path, or those of several images.
    rate
        Frames a second that the camera took; None to read it from the video.
    default_rate
        Frames a second of images, where ``rate`` is None.

    Raises
    ------
    FootageError
        When it cannot be read.
    MissingExtraError
        When it is a video and PyAV is not installed.
    """
    if not isinstance(path, Path):
        if len(path) > 1:
            return ImageSequence.from_files(path, rate or default_rate, "the images")
        path = path[0]
    if os.path.isdir(path):  # noqa: PTH112 - unlike Path's, False for names that are too long
        return ImageSequence.from_folder(path, rate or default_rate)
    if is_tiff(path):
        return ImageSequence.from_stack(path, rate or default_rate)
    if is_single_picture(path):
        raise FootageError(
            f"{shown_path(path)} is one picture, expected a video, a folder of images or at least "
            f"{OBSERVED_FRAMES} images"
        )
    try:
        from rollcast.video import VideoFile
    except ModuleNotFoundError as error:
        raise MissingExtraError("videos need", "PyAV", "video") from error
    return VideoFile(path, camera_hz=rate)
