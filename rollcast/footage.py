"""Frames cut out of footage, with their times; footage that lies as image files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, ImageOps

from rollcast.errors import CropError, FootageError
from rollcast.trajectory import FRAME_RATE_HZ

RATE_TOLERANCE = 0.05
"""Relative difference between rates that counts as none."""
SNAP = 0.1
"""Share of the time between two frames by which one of them may come early or late."""


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
    blended_over_s: float = 0.0
    """Longest time between two frames of the camera that one of these is blended from; 0 when all
    are as the camera took them."""

    @property
    def frame_rate(self) -> float:
        """Frames a second, on average."""
        return (len(self.times_s) - 1) / float(self.times_s[-1] - self.times_s[0])

    def part(self, index: slice | Sequence[int]) -> "Footage":
        """Return some of the frames."""
        return Footage(self.frames[index], self.times_s[index], self.crop, self.blended_over_s)

    def resampled(self, frame_rate: float, count: int) -> "Footage":
        """Return some frames at even times from the first one on (:func:`between`).

        Raises
        ------
        FootageError
            When the footage ends before the last of them.
        """
        wanted_s = float(self.times_s[0]) + np.arange(count) / frame_rate
        if wanted_s[-1] > self.times_s[-1] + SNAP / frame_rate:
            raise FootageError(
                f"the frames end after {self.times_s[-1]:.3f} s; {count} frames, {frame_rate:g} a "
                f"second, need {wanted_s[-1]:.3f} s"
            )
        made: list[TimedFrame] = []
        for time_s in wanted_s.tolist():
            taken_before = int(np.count_nonzero(self.times_s < time_s))
            after = min(max(taken_before, 1), len(self.times_s) - 1)
            around = (*self._taken(after - 1), *self._taken(after))
            made.append(between(*around, time_s, SNAP / frame_rate))
        whole = SquareCrop.centred(*self.frames.shape[2:0:-1])
        return replace(from_moments(made, whole), crop=self.crop)

    def _taken(self, index: int) -> tuple[UInt8[np.ndarray, "S S 3"], float]:
        return self.frames[index], float(self.times_s[index])


@dataclass(frozen=True)
class TimedFrame:
    """A picture and when it was taken, or would have been."""

    picture: UInt8[np.ndarray, "height width 3"]
    time_s: float
    blended_over_s: float = 0.0
    """Time between the two pictures that it is blended from; 0 when it was taken."""


def between(
    before: UInt8[np.ndarray, "height width 3"],
    before_s: float,
    after: UInt8[np.ndarray, "height width 3"],
    after_s: float,
    time_s: float,
    near_s: float,
) -> TimedFrame:
    """Return the picture at a time between two: the two of them, faded into each other.

    A forecast from pictures made so is nearly as good as one from pictures that were taken then,
    while one that mistakes the time between its pictures is far off (decision 0122).

    Parameters
    ----------
    near_s
        A picture that was taken so near to the time is returned as it is, with its own time.
    """
    nearest, nearest_s = min((before, before_s), (after, after_s), key=lambda p: abs(p[1] - time_s))
    if abs(nearest_s - time_s) <= near_s:
        return TimedFrame(nearest, nearest_s)
    share = (time_s - before_s) / (after_s - before_s)
    mixed = (1 - share) * before.astype(np.float32) + share * after.astype(np.float32)
    return TimedFrame(mixed.round().astype(np.uint8), time_s, after_s - before_s)


def from_moments(moments: Sequence[TimedFrame], crop: SquareCrop | None) -> Footage:
    """Cut the same square out of every picture, by default the largest one in their middle."""
    height, width = moments[0].picture.shape[:2]
    crop = crop or SquareCrop.centred(width, height)
    return Footage(
        np.stack([crop.cut(moment.picture) for moment in moments]),
        np.array([moment.time_s for moment in moments], np.float64),
        crop,
        max(moment.blended_over_s for moment in moments),
    )


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
    moments = [TimedFrame(picture, index / frame_rate) for index, picture in enumerate(pictures)]
    return from_moments(moments, crop)


def _read_image(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    try:
        with Image.open(path) as image:
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "not an image"
        raise FootageError(f"{path} cannot be read: {reason}") from error
