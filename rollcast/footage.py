"""Frames cut out of footage, with their times; footage that lies as image files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, ImageOps

from rollcast.errors import CropError, FootageError
from rollcast.trajectory import FRAME_RATE_HZ


@dataclass(frozen=True)
class SquareCrop:
    """A square of a picture.

    Attributes
    ----------
    x, y
        Columns left of it and rows above it, pixels.
    size
        Side, pixels.
    """

    x: int
    y: int
    size: int

    @classmethod
    def centred(cls, width: int, height: int) -> "SquareCrop":
        """Return the largest square in the middle of a picture."""
        size = min(width, height)
        return cls((width - size) // 2, (height - size) // 2, size)

    def cut(self, picture: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "S S 3"]:
        """Return a copy of the square.

        Raises
        ------
        CropError
            When it does not lie inside the picture.
        """
        height, width = picture.shape[:2]
        right, bottom = self.x + self.size, self.y + self.size
        if self.size < 1 or self.x < 0 or self.y < 0 or right > width or bottom > height:
            raise CropError(
                f"the crop {self.x},{self.y},{self.size} spans x {self.x}..{right} and "
                f"y {self.y}..{bottom}, the picture is {width} x {height}"
            )
        return picture[self.y : bottom, self.x : right].copy()


@dataclass(frozen=True)
class Footage:
    """Square frames and when they were taken."""

    frames: UInt8[np.ndarray, "frames S S 3"]
    """RGB."""
    times_s: Float64[np.ndarray, " frames"]
    """Seconds after the first frame of the whole footage."""
    crop: SquareCrop
    """What of the picture they show."""

    @property
    def frame_rate(self) -> float:
        """Frames a second, on average."""
        return (len(self.times_s) - 1) / float(self.times_s[-1] - self.times_s[0])

    @property
    def unevenness(self) -> float:
        """Largest deviation of a frame's distance to the next from the average, a share of it."""
        return float(np.max(np.abs(np.diff(self.times_s) * self.frame_rate - 1)))

    def part(self, index: slice | Sequence[int]) -> "Footage":
        """Return some of the frames."""
        return Footage(self.frames[index], self.times_s[index], self.crop)


def cut_out(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]],
    times_s: Sequence[float],
    crop: SquareCrop | None,
) -> Footage:
    """Cut the same square out of every picture, by default the largest one in their middle."""
    height, width = pictures[0].shape[:2]
    crop = crop or SquareCrop.centred(width, height)
    frames = np.stack([crop.cut(picture) for picture in pictures])
    return Footage(frames, np.array(times_s, np.float64), crop)


def read_images(
    paths: Sequence[Path], *, crop: SquareCrop | None = None, frame_rate: float = FRAME_RATE_HZ
) -> Footage:
    """Read image files as frames that follow each other.

    Parameters
    ----------
    paths
        Files that Pillow reads, in order.
    crop
        By default the largest square in the middle.
    frame_rate
        Frames a second.

    Raises
    ------
    FootageError
        When a file cannot be read or the sizes differ.
    CropError
        When the crop does not lie inside the pictures.
    """
    pictures = [_read_image(path) for path in paths]
    for path, picture in zip(paths, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            height, width = picture.shape[:2]
            expected = f"{pictures[0].shape[1]} x {pictures[0].shape[0]}"
            raise FootageError(f"{path} is {width} x {height}, the first image {expected}")
    return cut_out(pictures, [index / frame_rate for index in range(len(paths))], crop)


def _read_image(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    try:
        with Image.open(path) as image:
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "not an image"
        raise FootageError(f"{path} cannot be read: {reason}") from error
