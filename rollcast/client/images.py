"""Frames as a user has them become files that the service reads."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image, ImageOps

Frame = np.ndarray | Image.Image | Path | str
"""RGB uint8 [height, width, 3], a Pillow image, or the path of a PNG, JPEG or WebP file."""
Frames = Sequence[Frame] | np.ndarray
"""Several of them in order, or one array [frames, height, width, 3]."""
Crop = Literal["square"]
"""``square`` cuts the largest square out of the middle of every frame."""


def encoded(frame: Frame, crop: Crop | None) -> bytes:
    """Return a frame as a file; one that is a file already is left as it is, unless cropped.

    Raises
    ------
    TypeError
        When an array is not uint8.
    ValueError
        When an array has not the shape [height, width, 3].
    OSError
        When a file cannot be read.
    """
    if isinstance(frame, str | Path) and crop is None:
        return Path(frame).read_bytes()
    buffer = io.BytesIO()
    _cropped(frame, crop).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def pixels(frame: Frame, crop: Crop | None) -> np.ndarray:
    """Return a frame's pixels, uint8 [height, width, 3]; raises as ``encoded`` does."""
    return np.asarray(_cropped(frame, crop).convert("RGB"))


def decoded(data: bytes) -> np.ndarray:
    """Return the pixels of an image file, uint8 [height, width, 3]."""
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def _cropped(frame: Frame, crop: Crop | None) -> Image.Image:
    image = _image(frame)
    if crop is None:
        return image
    side = min(image.size)
    left, top = (image.width - side) // 2, (image.height - side) // 2
    return image.crop((left, top, left + side, top + side))


def _image(frame: Frame) -> Image.Image:
    if isinstance(frame, Image.Image):
        return ImageOps.exif_transpose(frame)
    if isinstance(frame, str | Path):
        with Image.open(frame) as image:
            return ImageOps.exif_transpose(image)
    if frame.dtype != np.uint8:
        raise TypeError(f"a frame is an array of {frame.dtype}, expected uint8")
    if frame.ndim != 3 or frame.shape[2] != 3:
        raise ValueError(f"a frame has the shape {frame.shape}, expected [height, width, 3]")
    return Image.fromarray(frame)
