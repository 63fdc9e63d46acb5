"""Pictures of any kind become frames: RGB, uint8, [height, width, 3].

:func:`as_frame` is the only conversion: client, command line and training all go through it, and
:func:`to_rgb` is its rule for Pillow images. Each kind has one range everywhere.

=====================  ==========================================================
unsigned 16 bits       0 to 65535, divided by 257
floats                 0 to 1, times 255; other values are refused
bool                   False is black, True is white
transparent pixels     are composed on white
grey, palette, CMYK    are converted to RGB
EXIF orientation       is applied
several pictures       the first one of the file is taken
=====================  ==========================================================
"""

import io
import os
import stat
import struct
import zlib
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, cast, runtime_checkable

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from rollcast.errors import FootageError, FrameError


@runtime_checkable
class SupportsArray(Protocol):
    """A tensor of another library: it converts itself to a NumPy array."""

    def __array__(self) -> np.ndarray:
        """Return the values."""
        ...


@runtime_checkable
class SupportsRead(Protocol):
    """A file that is open for reading bytes."""

    def read(self) -> bytes:
        """Return the rest of the file."""
        ...


FrameLike: TypeAlias = (
    np.ndarray
    | Image.Image
    | os.PathLike[str]
    | str
    | bytes
    | bytearray
    | memoryview
    | SupportsRead
    | SupportsArray
)
"""An array, a Pillow image, a path, the bytes of an image file, an open file, or a tensor."""
Channels: TypeAlias = Literal["rgb", "bgr"]

FORMATS = ("AVIF", "BMP", "GIF", "JPEG", "JPEG2000", "MPO", "PNG", "PPM", "TIFF", "WEBP")
"""Formats that are opened; others of Pillow's run programs or are no photographs."""
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
    Image.DecompressionBombError,
)
"""Exceptions that Pillow raises on damaged files."""
START_OF_JPEG = b"\xff\xd8\xff"
END_OF_IMAGE = b"\xff\xd9"
"""Marker that ends a JPEG file."""
FILLINGS = (b"", b"\x55" * 4096, b"\xaa" * 4096)
"""Substitutes for the missing end of a JPEG file; pixels before the end do not depend on it."""
HEIC_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
MAX_PIXELS = 64 * 10**6
"""Pixels of the largest picture that is read; four of them take a gigabyte."""
FLOAT_SLACK = 1e-3
"""Distance from 0 to 1 by which rounding may carry a float."""


def as_frame(picture: FrameLike, *, channels: Channels = "rgb") -> UInt8[np.ndarray, "H W 3"]:
    """Convert a picture to a frame.

    Parameters
    ----------
    picture
        The path or the bytes of an image file, a file opened for reading bytes, a Pillow image of
        any mode, or an array or tensor: [height, width], [height, width, channels] or
        [channels, height, width] with 1 (grey), 3 or 4 (with transparency) channels; uint8,
        uint16 (0 to 65535), floats (0 to 1) or bool.
    channels
        Order of the channels of arrays and tensors; ``"bgr"`` for those of OpenCV.

    Returns
    -------
    numpy.ndarray
        RGB, uint8, [height, width, 3].

    Raises
    ------
    TypeError
        When the object is no picture, or its numbers are of another kind.
    FrameError
        When the picture is damaged, or its shape or values are not those above.
    OSError
        When a file cannot be read.
    """
    if channels not in ("rgb", "bgr"):
        raise ValueError(f"channels is {channels!r}, expected 'rgb' or 'bgr'")
    if isinstance(picture, np.ndarray):
        return _from_array(cast("np.ndarray", picture), channels)
    if isinstance(picture, Image.Image):
        return _pixels(picture, "the image")
    if isinstance(picture, str | os.PathLike):
        return _from_bytes(read_file(picture), shown_path(picture))
    if isinstance(picture, bytes | bytearray | memoryview):
        return _from_bytes(bytes(picture), f"an image of {len(bytes(picture))} bytes")
    if isinstance(picture, SupportsRead):
        return _from_bytes(_read_stream(picture), _name_of(picture))
    if isinstance(picture, SupportsArray):  # pyright: ignore[reportUnnecessaryIsInstance]
        return _from_array(_from_tensor(picture), channels)
    raise TypeError(
        f"a frame is of type {type(picture).__name__}, expected a path, bytes, an open file, a "
        "Pillow image, a NumPy array or a tensor (numpy.asarray makes an array of lists)"
    )


def encode_png(picture: UInt8[np.ndarray, "H W 3"], compress_level: int = 1) -> bytes:
    """Encode a picture as a PNG file; higher levels take several times as long."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", compress_level=compress_level)
    return buffer.getvalue()


def to_rgb(image: Image.Image) -> Image.Image:
    """Convert a Pillow image of any mode to RGB by the rule of this module.

    Raises
    ------
    FrameError
        When the values of a 32-bit image are out of range.
    ValueError
        When Pillow cannot convert the mode.
    """
    if image.mode == "F" or image.mode.startswith("I"):
        values = np.asarray(image)
        if image.mode == "I":  # 32 bits, in which Pillow holds 16
            _require_range(values, 0, 65535, "32-bit integers", "scale it to 16 bits")
            values = values.astype(np.uint16)
        return Image.fromarray(_to_8_bits(values)).convert("RGB")
    if image.has_transparency_data:
        layer = image.convert("RGBA")
        return Image.alpha_composite(Image.new("RGBA", layer.size, "white"), layer).convert("RGB")
    return image if image.mode == "RGB" else image.convert("RGB")


def open_image(source: Path | str | io.BytesIO) -> Image.Image:
    """Open an image file of one of FORMATS; its pixels are read later, by Pillow.

    Raises
    ------
    PIL.UnidentifiedImageError
        When it is none.
    """
    return Image.open(source, formats=_formats())


def is_image_name(name: str) -> bool:
    """Return whether a file name has the suffix of one of FORMATS."""
    _formats()
    ending = Path(name).suffix.lower()
    return Image.registered_extensions().get(ending) in FORMATS


def completed(data: bytes) -> list[bytes]:
    """Complete a JPEG file that lacks its last marker, in several ways.

    Returns
    -------
    list
        Files whose pixels are equal if none is missing; empty for any other file.
    """
    if not data.startswith(START_OF_JPEG) or data.endswith(END_OF_IMAGE):
        return []
    begun = data.removesuffix(END_OF_IMAGE[:1])
    return [begun + filling + END_OF_IMAGE for filling in FILLINGS]


def is_heic(head: bytes) -> bool:
    """Return whether a file begins like a HEIC (iPhone) picture."""
    return head[4:8] == b"ftyp" and head[8:12] in HEIC_BRANDS


def decoded_page(image: Image.Image, name: str) -> UInt8[np.ndarray, "H W 3"]:
    """Read the current page of an open file of several pictures.

    Raises
    ------
    FrameError
        When it is damaged.
    """
    return _pixels(image, name)


def read_file(path: os.PathLike[str] | str) -> bytes:
    """Read a regular file whole.

    Raises
    ------
    FootageError
        When it is a pipe, a device or a socket.
    OSError
        When it cannot be read.
    """
    require_regular_file(path)
    return Path(path).read_bytes()


def require_regular_file(path: os.PathLike[str] | str) -> None:
    """Reject files that would block reading.

    Raises
    ------
    FootageError
        If the path is a pipe, a device or a socket, or contains a null character.
    OSError
        If the path does not exist.
    """
    try:
        mode = Path(path).stat().st_mode
    except ValueError as error:
        raise FootageError(f"{str(path)!r} is no path: {error}") from error
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        kind = "a pipe" if stat.S_ISFIFO(mode) else "a device or a socket"
        raise FootageError(
            f"{shown_path(path)} is {kind}, but frames are read from several positions of a "
            "file: write it to a regular file first"
        )


def shown_path(path: os.PathLike[str] | str) -> str:
    """Return a path as printable text, for any bytes in its name."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


@lru_cache(maxsize=1)
def _formats() -> tuple[str, ...]:
    Image.init()
    return tuple(name for name in FORMATS if name in Image.OPEN)


def _from_bytes(data: bytes, name: str) -> UInt8[np.ndarray, "H W 3"]:
    try:
        with open_image(io.BytesIO(data)) as image:
            return _pixels(image, name)
    except Image.UnidentifiedImageError as error:
        raise FrameError(_unidentified(data, name)) from error
    except FrameError:
        decoded = [_from_bytes(whole, name) for whole in completed(data)]
        if not decoded:
            raise
        if any((one != decoded[0]).any() for one in decoded):
            raise FrameError(f"{name} is cut off: pixels at its end are missing") from None
        return decoded[0]
    except DECODER_ERRORS as error:
        raise FrameError(f"{name} is damaged: {_reason(error)}") from error


def _pixels(image: Image.Image, name: str) -> UInt8[np.ndarray, "H W 3"]:
    if image.width * image.height > MAX_PIXELS:
        raise FrameError(
            f"{name} has {image.width} x {image.height} pixels, expected at most "
            f"{MAX_PIXELS // 10**6} million: scale it down"
        )
    try:
        image.load()
    except DECODER_ERRORS as error:
        raise FrameError(f"{name} is damaged: {_reason(error)}") from error
    try:
        return np.asarray(to_rgb(ImageOps.exif_transpose(image)))
    except FrameError as error:
        raise FrameError(f"{name}: {error}") from error
    except DECODER_ERRORS as error:
        raise FrameError(
            f"{name} ({image.mode}, {image.width} x {image.height}) cannot be converted to RGB: "
            f"{_reason(error)}"
        ) from error


def _unidentified(data: bytes, name: str) -> str:
    if is_heic(data[:12]):
        return (
            f"{name} is a HEIC picture, which cannot be read: convert it to JPEG or PNG (on an "
            "iPhone: Settings, Camera, Formats, Most Compatible)"
        )
    return f"{name} is not an image, expected one of {', '.join(_formats())}"


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _read_stream(file: SupportsRead) -> bytes:
    if isinstance(file, io.TextIOBase):
        raise TypeError("a frame is a file opened as text; open it with mode 'rb'")
    return bytes(file.read())


def _name_of(file: SupportsRead) -> str:
    name = getattr(file, "name", None)
    return shown_path(name) if isinstance(name, str) else "the open file"


def _from_tensor(tensor: SupportsArray) -> np.ndarray:
    """Convert a tensor: torch's may need gradients, lie on a device or be a bfloat16."""
    detach = getattr(tensor, "detach", None)
    if detach is None:
        return np.asarray(tensor)
    values: Any = detach().cpu()
    return np.asarray(values.float() if "bfloat16" in str(values.dtype) else values)


def _from_array(array: np.ndarray, channels: Channels) -> UInt8[np.ndarray, "H W 3"]:
    rows_first = _rows_first(array)
    if not rows_first.size:
        raise FrameError(f"a frame has the shape {array.shape}, it has no pixels")
    pixels = _to_8_bits(rows_first)
    count = pixels.shape[2]
    if count == 1:
        return np.repeat(pixels, 3, axis=2)
    if channels == "bgr":
        pixels = pixels[..., [2, 1, 0, 3][:count]]
    if count == 4:
        return np.asarray(to_rgb(Image.fromarray(np.ascontiguousarray(pixels))))
    return np.ascontiguousarray(pixels)


def _rows_first(array: np.ndarray) -> np.ndarray:
    if array.ndim == 2:
        return array[..., None]
    if array.ndim == 3 and array.shape[2] in (1, 3, 4):
        return array
    if array.ndim == 3 and array.shape[0] in (1, 3, 4):
        return np.moveaxis(array, 0, 2)
    raise FrameError(
        f"a frame has the shape {array.shape}, expected [height, width], [height, width, 1, 3 or "
        "4] or [1, 3 or 4, height, width]; pass several frames as a list"
    )


def _to_8_bits(values: np.ndarray) -> UInt8[np.ndarray, "*shape"]:
    """Bring numbers to 0 to 255 by the ranges of this module."""
    kind, size = values.dtype.kind, values.dtype.itemsize
    if values.dtype == np.uint8:
        return values
    if kind == "b":
        return values.astype(np.uint8) * np.uint8(255)
    if kind == "u" and size == 2:
        return (values.astype(np.float32) / 257).round().astype(np.uint8)
    if kind == "f":
        fix = "divide by the largest possible value, such as 255"
        _require_range(values, -FLOAT_SLACK, 1 + FLOAT_SLACK, "floats", fix)
        return (values.clip(0, 1).astype(np.float32) * 255).round().astype(np.uint8)
    raise TypeError(
        f"a frame is an array of {values.dtype}, expected uint8 (0 to 255), uint16 (0 to 65535), "
        "floats (0 to 1) or bool: convert it with .astype(numpy.uint8)"
    )


def _require_range(values: np.ndarray, low: float, high: float, kind: str, fix: str) -> None:
    least, largest = float(values.min()), float(values.max())
    if not (low <= least and largest <= high):  # also when there is a NaN
        raise FrameError(
            f"a frame of {kind} has values from {least:g} to {largest:g}, expected "
            f"{abs(round(low))} to {round(high)}: {fix}"
        )
