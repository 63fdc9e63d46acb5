"""Frames as a user has them become files that the service reads."""

import os
from collections.abc import Sequence
from typing import Literal, Protocol, cast

import numpy as np

from rollcast.footage import SquareCrop
from rollcast.frames import (
    END_OF_IMAGE,
    Channels,
    FrameLike,
    SupportsArray,
    as_frame,
    encode_png,
    read_file,
)

Frame = FrameLike
"""Any input of ``rollcast.frames.as_frame``: an array or tensor, a Pillow image, a path, bytes or
an open file."""


class FrameTensor(Protocol):
    """A tensor of another library that holds several frames."""

    def __len__(self) -> int:
        """Return how many there are."""
        ...

    def __getitem__(self, index: int, /) -> SupportsArray:
        """Return one of them."""
        ...


Frames = Sequence[Frame] | np.ndarray | FrameTensor
"""Sequence of frames in order, or one array or tensor of frames."""
Crop = Literal["square"]
"""Crop of every frame: ``square`` is the largest square in its middle."""


def each(frames: Frames) -> list[Frame]:
    """Return frames one by one.

    Raises
    ------
    TypeError
        When it is one picture, or the name of one.
    """
    shape: tuple[int, ...] = tuple(getattr(frames, "shape", ()))
    is_file = isinstance(frames, str | bytes | bytearray | memoryview | os.PathLike)
    if is_file or not hasattr(frames, "__len__"):
        kind = type(cast("object", frames)).__name__
        raise TypeError(f"frames is one {kind}, expected a list of four")
    is_picture = len(shape) == 3 and (shape[2] in (1, 3, 4) or shape[0] in (1, 3))
    if len(shape) == 2 or is_picture:
        raise TypeError(f"frames is one picture of the shape {shape}, expected a list of four")
    return [frames[index] for index in range(len(frames))]


def encoded(frame: Frame, crop: Crop | None, channels: Channels = "rgb") -> bytes:
    """Return a frame as a file; one that the service reads is left as it is, unless cropped.

    Parameters
    ----------
    channels
        Order of the channels of arrays and tensors.

    Raises
    ------
    TypeError, FrameError, OSError
        As ``rollcast.frames.as_frame`` does.
    """
    if crop is None and isinstance(frame, bytes | bytearray | memoryview | str | os.PathLike):
        is_path = isinstance(frame, str | os.PathLike)
        data = read_file(frame) if is_path else bytes(frame)
        if _is_read_by_the_service(data):
            return data
    return encode_png(pixels(frame, crop, channels))


def pixels(frame: Frame, crop: Crop | None, channels: Channels = "rgb") -> np.ndarray:
    """Return a frame's pixels, uint8 [height, width, 3]; raises as ``encoded`` does."""
    picture = as_frame(frame, channels=channels)
    if crop is None:
        return picture
    return SquareCrop.centred(picture.shape[1], picture.shape[0]).cut(picture)


def decoded(data: bytes) -> np.ndarray:
    """Return the pixels of an image file, uint8 [height, width, 3]."""
    return as_frame(data)


def _is_read_by_the_service(data: bytes) -> bool:
    """Return whether bytes are a PNG, WebP or complete JPEG file."""
    if data.startswith(b"\xff\xd8\xff"):
        return data.endswith(END_OF_IMAGE)
    is_webp = data.startswith(b"RIFF") and data[8:12] == b"WEBP"
    return is_webp or data.startswith(b"\x89PNG\r\n\x1a\n")
