"""Encoded images in, 128 x 128 frames out. Format, size and cost are checked before any pixel."""

import io
import math
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.frames import START_OF_JPEG, completed, to_rgb
from rollcast.schemas import MAX_FRAME_SIZE, MIN_FRAME_SIZE
from service.errors import BrokenImageError, InvalidValueError, NotAnImageError, ServiceError

SIDES = f"a square of {MIN_FRAME_SIZE} to {MAX_FRAME_SIZE} pixels a side"
RECTANGLES = f"a picture of {MIN_FRAME_SIZE} to {MAX_FRAME_SIZE} pixels a side"
MAX_SCANS = 32
"""Scans of a progressive JPEG; encoders write ten to twenty. Each passes over all pixels."""
START_OF_SCAN = b"\xff\xda"
MAX_READS = 10_000
"""Pieces (segments, chunks) of a file beyond one for every PIECE_BYTES of it."""
PIECE_BYTES = 256
SLOW_PIXELS = 8 * 2**20
"""Pixels that are decoded in about the time of a forecast, those of each scan counted."""
DECODED_BYTES = 4096
"""Bytes that are decoded before the decoder may be interrupted."""
MAX_KEPT_BYTES = 8 * 2**20
"""Decoded bytes of one frame that a session keeps: 1920 x 1080 pixels have 6 MB."""
MAX_HEADER_BYTES = 4 * 2**20
"""Bytes before the pixels of a JPEG or PNG file: profiles, previews, notes."""
PICTURE_CHUNKS = frozenset({b"tRNS", b"eXIf"})
"""Chunks of a PNG file that are read beside the critical ones: transparency and orientation."""
ORIENTATION_TAG = 0x0112
TURNS: Mapping[int, Image.Transpose] = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""Transposition that turns a picture upright, by its EXIF orientation."""
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
"""Exceptions that Pillow raises on damaged files."""

Check = Callable[[], None]
"""Function that raises when the request is cancelled."""


class _Source(io.BytesIO):
    """A file that its decoder reads in pieces, whose number is limited.

    Raises
    ------
    InvalidValueError
        From ``read``, when the file has too many pieces or too long a header.
    """

    def __init__(self, data: bytes, field: str, check: Check) -> None:
        super().__init__(data)
        self.header = True
        self._field = field
        self._check = check
        self._reads = MAX_READS + len(data) // PIECE_BYTES

    def read(self, size: int | None = -1, /) -> bytes:
        """Read a piece, unless the decoder shall end."""
        self._check()
        self._reads -= 1
        if self._reads < 0:
            raise _many_pieces(self._field)
        if self.header and self.tell() > MAX_HEADER_BYTES:
            value = f"more than {MAX_HEADER_BYTES} bytes before the pixels"
            raise InvalidValueError.at(self._field, value, "an image with less metadata")
        return super().read(size)


def _many_pieces(field: str) -> ServiceError:
    return InvalidValueError.at(field, "a file of many pieces", "fewer, longer pieces")


class _Jpeg(JpegImageFile):
    """Pillow's own, whose EXIF block is not unfolded: entries that overlap make it any size."""

    def _read_dpi_from_exif(self) -> None:
        pass


PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
READERS: Mapping[bytes, type[ImageFile.ImageFile]] = {
    PNG_SIGNATURE: PngImageFile,
    START_OF_JPEG: _Jpeg,
    b"RIFF": WebPImageFile,
}
"""Supported formats by the first bytes of their files."""


class OpenedFrames:
    """The frames of one request, after their headers have been read.

    Parameters
    ----------
    images
        PNG, JPEG or WebP files of one size; ``KeptImage`` where their pixels serve again.
    fields
        Name of each in the request, for messages.
    check
        Called between pieces of the work; its exception ends the decoding.

    Raises
    ------
    NotAnImageError, BrokenImageError, InvalidValueError
        With the field at fault.
    """

    def __init__(
        self,
        images: Sequence["bytes | KeptImage"],
        fields: Sequence[str],
        check: Check = lambda: None,
    ) -> None:
        files = zip(images, fields, strict=True)
        self._files = [
            _KeptFile(image, field, check)
            if isinstance(image, KeptImage)
            else _File(image, field, check)
            for image, field in files
        ]
        self._sizes = [file.size for file in self._files]
        width, height = self._sizes[0]
        self.is_square = all(width == height for width, height in self._sizes)
        self.slow = width * height * sum(file.passes for file in self._files) > SLOW_PIXELS
        """True if decoding them takes long beside a forecast."""

    @property
    def side(self) -> int:
        """Side of square frames, in pixels."""
        return self._sizes[0][0]

    def require_squares(self) -> None:
        """Refuse frames that are not square, or of several sizes.

        Raises
        ------
        InvalidValueError
            With the field at fault.
        """
        for (width, height), file in zip(self._sizes, self._files, strict=True):
            if width != height:
                raise InvalidValueError.at(file.field, f"{width} x {height}", SIDES)
        _require_one_size(self._sizes)

    def decode(self) -> UInt8[np.ndarray, "K 128 128 3"]:
        """Decode square frames, once, to RGB of the networks' size.

        Raises
        ------
        BrokenImageError, InvalidValueError
            With the field at fault.
        """
        self.require_squares()
        # Popped, so that the pixels of one large frame are freed before the next is decoded.
        return np.stack([self._files.pop(0).at_network_size() for _ in self._sizes])

    def decode_whole(self) -> UInt8[np.ndarray, "K height width 3"]:
        """Decode the frames, once, to RGB of their own size.

        Raises
        ------
        BrokenImageError, InvalidValueError
            With the field at fault.
        """
        # The size after decoding counts: the header of a photo may rotate it.
        frames = [self._files.pop(0).whole() for _ in self._sizes]
        _require_one_size([(frame.shape[1], frame.shape[0]) for frame in frames])
        return np.stack(frames)


def _require_one_size(sizes: Sequence[tuple[int, int]]) -> None:
    if len(set(sizes)) > 1:
        value = ", ".join(f"{width} x {height}" for width, height in sizes)
        raise InvalidValueError.at("frames", value, "frames of one size")


class _File:
    """An image file whose header has been read."""

    def __init__(self, data: bytes, field: str, check: Check) -> None:
        self.field = field
        self._data, self._check = data, check
        self.image = _open(data, field, check)
        self.size = self.image.size
        self.passes = data.count(START_OF_SCAN) if isinstance(self.image, _Jpeg) else 1
        """Times that the decoder passes over all pixels."""

    def at_network_size(self) -> UInt8[np.ndarray, "128 128 3"]:
        """Decode a square frame to RGB of the networks' size."""
        return _to_network_size(_upright(self.decode()))

    def whole(self) -> UInt8[np.ndarray, "height width 3"]:
        """Decode to RGB of the frame's own size."""
        return np.asarray(_upright(self.decode()))

    def decode(self) -> Image.Image:
        """Decode the pixels; a JPEG file may lack its last marker, but no pixel."""
        try:
            self.image.load()
        except DECODER_ERRORS as error:
            whole = [_File(data, self.field, self._check) for data in completed(self._data)]
            try:
                for file in whole:
                    file.image.load()
            except DECODER_ERRORS:
                whole = []
            if not whole or any(file.image != whole[0].image for file in whole):
                value = f"{self.image.format} of {self.image.width} x {self.image.height}"
                expected = "a whole image, this one is cut off"
                raise BrokenImageError.at(self.field, value, expected) from error
            return whole[0].image
        return self.image


class KeptImage:
    """An image file that several forecasts read; its pixels are decoded once.

    Pixels at the networks' size are always kept, whole ones up to MAX_KEPT_BYTES.

    Parameters
    ----------
    data
        The file.
    """

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.size: tuple[int, int] | None = None
        """Width and height, once the header has been read."""
        self.small: UInt8[np.ndarray, "128 128 3"] | None = None
        self.pixels: UInt8[np.ndarray, "height width 3"] | None = None

    @property
    def held_bytes(self) -> int:
        """Bytes of the file and of its pixels."""
        kept = [pixels.nbytes for pixels in (self.small, self.pixels) if pixels is not None]
        return len(self.data) + sum(kept)

    def forget_pixels(self) -> None:
        """Keep the file alone."""
        self.small = self.pixels = None


class _KeptFile:
    """The file of a ``KeptImage``, opened only where its pixels are not kept."""

    def __init__(self, image: KeptImage, field: str, check: Check) -> None:
        self.field = field
        self._image, self._check = image, check
        self._file = None if _is_decoded(image) else self._open()
        self.passes = 0 if self._file is None else self._file.passes
        if self._file is not None:
            image.size = self._file.size
        assert image.size is not None
        self.size = image.size

    def at_network_size(self) -> UInt8[np.ndarray, "128 128 3"]:
        image = self._image
        if image.small is None:
            if image.pixels is None:
                image.small = (self._file or self._open()).at_network_size()
            else:
                # Where a model of this size answers, whole pixels are hardly needed again.
                image.small, image.pixels = _to_network_size(Image.fromarray(image.pixels)), None
        return image.small

    def whole(self) -> UInt8[np.ndarray, "height width 3"]:
        pixels = self._image.pixels
        if pixels is None:
            pixels = (self._file or self._open()).whole()
            if pixels.nbytes <= MAX_KEPT_BYTES:
                self._image.pixels = pixels
        return pixels

    def _open(self) -> _File:
        return _File(self._image.data, self.field, self._check)


def _is_decoded(image: KeptImage) -> bool:
    return image.small is not None or image.pixels is not None


def _open(data: bytes, field: str, check: Check) -> ImageFile.ImageFile:
    """Read the header alone. Pillow's own ``open`` would refuse large images without their size."""
    reader = next((READERS[start] for start in READERS if data.startswith(start)), None)
    if reader is None or (reader is WebPImageFile and data[8:12] != b"WEBP"):
        raise NotAnImageError.at(field, data, "a PNG, JPEG or WebP file")
    if reader is _Jpeg and (scans := data.count(START_OF_SCAN)) > MAX_SCANS:
        raise InvalidValueError.at(field, f"a JPEG of {scans} scans", f"at most {MAX_SCANS} scans")
    plain = _without_notes(data, field) if reader is PngImageFile else data
    source = _Source(plain, field, check)
    try:
        image = reader(source)
    except Image.DecompressionBombError as error:
        raise InvalidValueError.at(field, str(error), SIDES) from error
    except DECODER_ERRORS as error:
        raise BrokenImageError.at(field, data, "a whole image, its header is damaged") from error
    source.header = False
    image.decodermaxblock = DECODED_BYTES
    width, height = image.size
    if not all(MIN_FRAME_SIZE <= side <= MAX_FRAME_SIZE for side in image.size):
        expected = SIDES if width == height else RECTANGLES
        raise InvalidValueError.at(field, f"{width} x {height}", expected)
    return image


def _without_notes(data: bytes, field: str) -> bytes:
    """Return a PNG file without chunks that say nothing of the picture.

    Compressed ones (profiles, texts) would be unfolded to a thousand times their size.
    """
    kept, place = [PNG_SIGNATURE], len(PNG_SIGNATURE)
    chunks = MAX_READS + len(data) // PIECE_BYTES
    while place + 12 <= len(data):
        chunks -= 1
        if chunks < 0:
            raise _many_pieces(field)
        (length,) = struct.unpack_from(">I", data, place)
        kind, end = data[place + 4 : place + 8], place + 12 + length
        if kind in PICTURE_CHUNKS or kind[:1].isupper():
            kept.append(data[place:end])
        place = end
    return b"".join(kept)


def _upright(image: Image.Image) -> Image.Image:
    turn = TURNS.get(_orientation(image.info))
    return to_rgb(image if turn is None else image.transpose(turn))


def _orientation(info: Mapping[Any, Any]) -> int:
    """Return the orientation that the EXIF block of a file tells; 1 is upright."""
    exif: bytes = info.get("exif", b"").removeprefix(b"Exif\0\0")
    order = "<" if exif.startswith(b"II") else ">"
    try:
        (start,) = struct.unpack_from(f"{order}I", exif, 4)
        (entries,) = struct.unpack_from(f"{order}H", exif, start)
        for entry in range(entries):
            tag, value = struct.unpack_from(f"{order}H6xH", exif, start + 2 + 12 * entry)
            if tag == ORIENTATION_TAG:
                return value
    except struct.error:
        pass  # damaged, as metadata often is
    return 1


def _to_network_size(image: Image.Image) -> UInt8[np.ndarray, "128 128 3"]:
    """Average areas when shrinking, interpolate when enlarging.

    Pillow's box filter counts a pixel wholly or not at all, which shifts small details by up to
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
