"""Square patches cut around balls out of frames of any size, as the patch refiner reads them.

Places are points of the letterboxed square: the frame is centred in a square as wide as its longer
side, whose points reach from -1 to 1 (x right, y down).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8
from PIL import Image

PATCH_SIZE = 32
"""Samples along a side of a patch."""

WIDTH_IN_RADII = 1.6
SMALLEST_HALF_WIDTH = 6 / 64
"""Half widths of patches: in ball radii, and the least, 6 px of a 128-px frame."""


@dataclass(frozen=True)
class Letterbox:
    """How a rectangle lies in the square.

    Parameters
    ----------
    height, width
        Of the frames, pixels.
    """

    height: int
    width: int

    @property
    def side(self) -> int:
        """Side of the square, pixels."""
        return max(self.height, self.width)

    def pixels(self, points: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Points of the square to pixels of the frame."""
        middle = np.array([self.width, self.height]) / 2
        return middle + np.asarray(points) * (self.side / 2)

    def points(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of the frame to points of the square."""
        middle = np.array([self.width, self.height]) / 2
        return (np.asarray(pixels) - middle) / (self.side / 2)


def half_widths(radii: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Half widths of the patches around balls of some radii, halves of the square."""
    return np.maximum(WIDTH_IN_RADII * np.asarray(radii), SMALLEST_HALF_WIDTH)


def cut_patches(
    frames: UInt8[np.ndarray, "frames height width 3"],
    centres: Float[np.ndarray, "balls frames 2"],
    widths: Float[np.ndarray, " balls"],
) -> Float32[np.ndarray, "balls frames 3 32 32"]:
    """Cut a patch around every ball out of every frame.

    Samples are averaged by a triangle as wide as two of them, at least two pixels; beyond the
    frame its border goes on. The cost grows with the patches' areas, not with the frames'.

    Parameters
    ----------
    centres
        Points of the square.
    widths
        Half widths of the patches, halves of the square.

    Returns
    -------
    Intensities -1 to 1.
    """
    box = Letterbox(*frames.shape[1:3])
    at = box.pixels(centres)
    balls, count = centres.shape[:2]
    patches = np.empty((balls, count, PATCH_SIZE, 3, PATCH_SIZE), np.float32)
    every = np.arange(count, dtype=np.intp)[:, None, None]
    for ball, width in enumerate(widths.tolist()):
        half = width * box.side / 2
        columns, across = _weights(at[ball, :, 0], half, box.width)
        rows, down = _weights(at[ball, :, 1], half, box.height)
        part = frames[every, rows[:, :, None], columns[:, None]].astype(np.float32)
        lines = down @ part.reshape(count, rows.shape[1], -1)
        lines = lines.reshape(count, PATCH_SIZE, -1, 3).transpose(0, 1, 3, 2)
        lines = lines.reshape(count, PATCH_SIZE * 3, -1) @ across.swapaxes(1, 2)
        patches[ball] = lines.reshape(count, PATCH_SIZE, 3, PATCH_SIZE)
    return patches.transpose(0, 1, 3, 2, 4) / np.float32(127.5) - np.float32(1)


_ALONG = ((np.arange(PATCH_SIZE) + 0.5) * (2 / PATCH_SIZE) - 1).astype(np.float32)


def _weights(
    centres: Float[np.ndarray, " frames"], half: float, size: int
) -> tuple[Int[np.ndarray, "frames pixels"], Float32[np.ndarray, "frames samples pixels"]]:
    """Pixels along one axis that patches read, and their shares in the samples."""
    reach = max(2 * half / PATCH_SIZE, 1.0)
    at = np.clip(centres[:, None] + half * _ALONG - 0.5, 0, size - 1).astype(np.float32)
    length = min(int(2 * (half + reach)) + 2, size)
    first = np.clip(np.ceil(at[:, 0] - reach).astype(np.intp), 0, size - length)
    pixels = first[:, None] + np.arange(length)
    weights = np.maximum(1 - np.abs(pixels[:, None] - at[:, :, None]) / np.float32(reach), 0)
    weights /= weights.sum(axis=2, keepdims=True)
    return pixels, weights.astype(np.float32)


def letterboxed(
    frames: UInt8[np.ndarray, "frames height width 3"], size: int
) -> UInt8[np.ndarray, "frames size size 3"]:
    """Shrink or enlarge frames into black squares; square ones of the size stay as they are.

    Areas are averaged when shrinking, each source pixel by the share that is covered.
    """
    height, width = frames.shape[1:3]
    if height == width == size:
        return frames
    side = max(height, width)
    columns, rows = max(round(width * size / side), 1), max(round(height * size / side), 1)
    left, top = (size - columns) // 2, (size - rows) // 2
    square = np.zeros((len(frames), size, size, 3), np.uint8)
    for inside, frame in zip(square, frames, strict=True):
        inside[top : top + rows, left : left + columns] = _resized(frame, rows, columns)
    return square


def _resized(
    frame: UInt8[np.ndarray, "height width 3"], rows: int, columns: int
) -> UInt8[np.ndarray, "rows columns 3"]:
    picture = Image.fromarray(frame)
    if rows > frame.shape[0] or columns > frame.shape[1]:
        return np.asarray(picture.resize((columns, rows), Image.Resampling.BILINEAR))
    # Whole pixels first: that is fast, and exact for squares of 128, 256, ... pixels.
    factor = max(
        frame.shape[0] // rows // 2 if frame.shape[0] % rows else frame.shape[0] // rows, 1
    )
    small = np.asarray(picture.reduce(factor) if factor > 1 else picture)
    if small.shape[:2] == (rows, columns):
        return small
    edges = np.arange(rows + 1, dtype=float) * (frame.shape[0] / factor / rows)
    averaged = _average_areas(small.astype(np.float32), edges)
    edges = np.arange(columns + 1, dtype=float) * (frame.shape[1] / factor / columns)
    averaged = _average_areas(averaged.swapaxes(0, 1), edges).swapaxes(0, 1)
    return averaged.round().astype(np.uint8)


def _average_areas(
    pixels: Float32[np.ndarray, "source across 3"], edges: Float[np.ndarray, " edges"]
) -> Float32[np.ndarray, "averages across 3"]:
    """Average along the first axis between edges, by an interpolated running sum."""
    sums = np.concatenate([np.zeros_like(pixels[:1], float), np.cumsum(pixels, 0, dtype=float)])
    low = np.minimum(edges.astype(np.intp), len(pixels) - 1)
    share = (edges - low)[:, None, None]
    at = sums[low] + share * (sums[low + 1] - sums[low])
    return (np.diff(at, axis=0) / np.diff(edges)[:, None, None]).astype(np.float32)
