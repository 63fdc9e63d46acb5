"""Pictures that follow each other become a video; all but GIF needs PyAV (extra ``video``)."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from rollcast.errors import FootageError, MissingExtraError

CODECS = {".mp4": "libx264", ".webm": "libvpx-vp9"}
QUALITY = {"crf": "18"}
"""Constant quality, visually close to the original pictures."""
GIF_TICK_MS = 10
"""A GIF's pictures last whole hundredths of a second."""


def write_video(path: Path, pictures: Iterable[Image.Image], frame_rate: float) -> None:
    """Write a video.

    Parameters
    ----------
    path
        .mp4, .webm or .gif.
    pictures
        RGB, all of one size; both sides even, unless for a GIF.
    frame_rate
        Pictures a second.

    Raises
    ------
    MissingExtraError
        When PyAV is not installed and the file is no GIF.
    FootageError
        When the file cannot be encoded.
    OSError
        When it cannot be written.
    """
    if path.suffix.lower() == ".gif":
        _write_gif(path, pictures, frame_rate)
    else:
        _encode(path, pictures, frame_rate)


def _write_gif(path: Path, pictures: Iterable[Image.Image], frame_rate: float) -> None:
    first, *others = [picture.quantize(dither=Image.Dither.NONE) for picture in pictures]
    # Rounded one by one, the pictures would last too long or too short together.
    ends = [
        round(1000 * (index + 1) / frame_rate / GIF_TICK_MS) * GIF_TICK_MS
        for index in range(1 + len(others))
    ]
    durations = np.diff([0, *ends]).tolist()
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0)


def _encode(path: Path, pictures: Iterable[Image.Image], frame_rate: float) -> None:
    try:
        import av
        from av.error import FFmpegError
    except ModuleNotFoundError as error:
        raise MissingExtraError("videos need", "PyAV", "video") from error
    try:
        # Python opens the file, because PyAV rejects names that are not UTF-8. Its types lack most
        # options.
        with path.open("wb") as file:
            opened: Any = av.open(file, "w", format=path.suffix.lower()[1:])
            with opened as container:
                _fill(container, CODECS[path.suffix.lower()], pictures, frame_rate)
    except FFmpegError as error:
        raise FootageError(f"{path} cannot be written: {error.strerror}") from error


def _fill(
    container: Any,  # noqa: ANN401 - PyAV is an extra
    codec: str,
    pictures: Iterable[Image.Image],
    frame_rate: float,
) -> None:
    from av import VideoFrame

    rate = Fraction(frame_rate).limit_denominator(1000)
    stream = container.add_stream(codec, rate=rate, options=QUALITY)
    stream.pix_fmt = "yuv420p"
    for index, picture in enumerate(pictures):
        if index == 0:
            stream.width, stream.height = picture.size
        frame = VideoFrame.from_ndarray(np.asarray(picture), format="rgb24")
        container.mux(stream.encode(frame))
    container.mux(stream.encode())
