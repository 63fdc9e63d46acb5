"""Encoded images in, 128 x 128 frames out. Format and size are checked before any pixel."""

import io
import math
import struct
import zlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, ImageFile, ImageOps
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.schemas import MAX_FRAME_SIZE, MIN_FRAME_SIZE
from service.errors import BrokenImageError, InvalidValueError, NotAnImageError

SIDES = f"a square of {MIN_FRAME_SIZE} to {MAX_FRAME_SIZE} pixels a side"
RECTANGLES = f"a picture of {MIN_FRAME_SIZE} to {MAX_FRAME_SIZE} pixels a side"
DECODER_ERRORS = (
    EOFError,
    IndexError,
    KeyError,
    OSError,
    OverflowError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""What Pillow raises on damaged files."""


def decode_frames(
    images: Sequence[bytes], fields: Sequence[str]
) -> tuple[UInt8[np.ndarray, "K 128 128 3"], int]:
    """Decode the frames of one request.

    Parameters
    ----------
    images
        PNG, JPEG or WebP files, square and of one size.
    fields
        Name of each in the request, for messages.

    Returns
    -------
    tuple
        RGB frames, and the side of the frames that were sent, in pixels.

    Raises
    ------
    NotAnImageError, BrokenImageError, InvalidValueError
        With the field at fault.
    """
    opened = [_open(data, field) for data, field in zip(images, fields, strict=True)]
    sides = [image.width for image in opened]
    if len(set(sides)) > 1:
        sizes = ", ".join(f"{side} x {side}" for side in sides)
        raise InvalidValueError.at("frames", sizes, "frames of one size")
    # Popped, so that the pixels of one large frame are freed before the next is decoded.
    frames = [_load(opened.pop(0), field) for field in fields]
    return np.stack(frames), sides[0]


def decode_rectangles(
    images: Sequence[bytes], fields: Sequence[str]
) -> UInt8[np.ndarray, "K height width 3"]:
    """Decode the frames of one request at their own size, which need not be square.

    Raises
    ------
    NotAnImageError, BrokenImageError, InvalidValueError
        With the field at fault.
    """
    opened = [_open(data, f, square=False) for data, f in zip(images, fields, strict=True)]
    # The pixels decide: a photo may be turned by what its header says.
    frames = [np.asarray(_loaded(opened.pop(0), field)) for field in fields]
    if len({frame.shape for frame in frames}) > 1:
        sizes = ", ".join(f"{frame.shape[1]} x {frame.shape[0]}" for frame in frames)
        raise InvalidValueError.at("frames", sizes, "frames of one size")
    return np.stack(frames)


def _open(data: bytes, field: str, *, square: bool = True) -> ImageFile.ImageFile:
    """Read the header alone. Pillow's own ``open`` would refuse large images without their size."""
    reader: type[ImageFile.ImageFile]
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        reader = PngImageFile
    elif data.startswith(b"\xff\xd8\xff"):
        reader = JpegImageFile
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        reader = WebPImageFile
    else:
        raise NotAnImageError.at(field, data, "a PNG, JPEG or WebP file")
    try:
        image = reader(io.BytesIO(data))
    except Image.DecompressionBombError as error:
        raise InvalidValueError.at(field, str(error), SIDES) from error
    except DECODER_ERRORS as error:
        raise BrokenImageError.at(field, data, "a whole image, its header is damaged") from error
    width, height = image.size
    in_range = all(MIN_FRAME_SIZE <= side <= MAX_FRAME_SIZE for side in image.size)
    if not in_range or (square and width != height):
        raise InvalidValueError.at(field, f"{width} x {height}", SIDES if square else RECTANGLES)
    return image


def _load(image: ImageFile.ImageFile, field: str) -> UInt8[np.ndarray, "128 128 3"]:
    return _to_network_size(_loaded(image, field))


def _loaded(image: ImageFile.ImageFile, field: str) -> Image.Image:
    try:
        image.load()
        ImageOps.exif_transpose(image, in_place=True)
    except DECODER_ERRORS as error:
        value = f"{image.format} of {image.width} x {image.height}"
        raise BrokenImageError.at(field, value, "a whole image, this one is cut off") from error
    return _to_rgb(image)


def _to_rgb(image: Image.Image) -> Image.Image:
    """Grey, palette and CMYK become RGB, 16 bits become 8, transparency lies on white."""
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.float32) / 257
        return Image.fromarray(grey.round().astype(np.uint8)).convert("RGB")
    if image.has_transparency_data:
        layer = image.convert("RGBA")
        return Image.alpha_composite(Image.new("RGBA", layer.size, "white"), layer).convert("RGB")
    return image if image.mode == "RGB" else image.convert("RGB")


def _to_network_size(image: Image.Image) -> UInt8[np.ndarray, "128 128 3"]:
    """Average areas when shrinking, interpolate when enlarging.

    Pillow's box filter counts a pixel wholly or not at all, which shifts what is small by up to
    half a pixel, so areas are averaged here unless whole pixels fill them.
    """
    factor, rest = divmod(image.width, NETWORK_FRAME_SIZE)
    if factor == 0:
        size = (NETWORK_FRAME_SIZE, NETWORK_FRAME_SIZE)
        return np.asarray(image.resize(size, Image.Resampling.BILINEAR))
    if rest == 0:
        return np.asarray(image if factor == 1 else image.reduce(factor))
    rows = _average_areas(np.asarray(image))
    return _average_areas(rows.swapaxes(0, 1)).swapaxes(0, 1).round().astype(np.uint8)


def _average_areas(pixels: np.ndarray) -> Float32[np.ndarray, "128 W 3"]:
    """Shrink the first axis; each source pixel counts by the share of it that is covered."""
    source = len(pixels)
    edges = np.arange(NETWORK_FRAME_SIZE + 1) * (source / NETWORK_FRAME_SIZE)
    low, high = edges[:-1], edges[1:]
    averages = np.zeros((NETWORK_FRAME_SIZE, *pixels.shape[1:]), np.float32)
    for offset in range(math.ceil(source / NETWORK_FRAME_SIZE) + 1):
        index = np.floor(low).astype(np.intp) + offset
        share = (np.minimum(index + 1, high) - np.maximum(index, low)).clip(0) / (high - low)
        averages += share[:, None, None].astype(np.float32) * pixels[index.clip(max=source - 1)]
    return averages
