"""Out-of-distribution score of four frames, and detection of frames without motion.

Frames are summarised in about forty numbers: their 8 x 8 thumbnail in the
principal components of the training frames, how much of it those leave unexplained, how fine its
texture is, and how much changes from frame to frame. The score is the Mahalanobis distance of these
numbers from the nearest kind of scenes in the training, relative to the usual distances there
(decision 0120). ``training.export.ood_fit`` fits it; the service warns with it.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image

from rollcast.trajectory import OBSERVED_FRAMES

SHRINK = 4
"""Sides of the areas that are averaged first, pixels: noise of the camera is gone then."""
THUMBNAIL = 8
"""Cells a side of the thumbnail."""
MOVED_LEVELS = 5.0
"""Change of an area's average, in levels of 0 to 255, where a ball appears or disappears."""
FLOOR = 1e-3
"""Offset of brightness in logarithms: a thousandth of the range is negligible."""


@dataclass(frozen=True)
class FrameStats:
    """Statistics of four frames."""

    thumbnail: Float32[np.ndarray, " 192"]
    """Mean of the four, 8 x 8 cells of three colours, 0..1."""
    texture: Float32[np.ndarray, " 7"]
    """Logarithms: how much neighbouring pixels of the last frame differ, by colour; how much each
    frame differs from the next; which share of the picture changes from the first to the last."""
    largest_change: float
    """Largest change of an area of SHRINK x SHRINK pixels from first to last frame, 0..255."""

    @property
    def is_still(self) -> bool:
        """Return whether nothing moves in the frames."""
        return self.largest_change < MOVED_LEVELS


def frame_stats(frames: UInt8[np.ndarray, "K 128 128 3"]) -> FrameStats:
    """Sum up the four observed frames; a final frame is left out."""
    seen = frames[:OBSERVED_FRAMES]
    side = seen.shape[1] // SHRINK
    # The frames below each other: Pillow is asked once.
    column = Image.fromarray(seen.reshape(-1, *seen.shape[2:])).reduce(SHRINK)
    small = np.asarray(column).reshape(-1, side, side, 3).astype(np.float32) / 255
    cells = side // THUMBNAIL
    # Axis after axis, here and below: NumPy takes several times as long for two at once.
    tiles = small.mean(axis=0).reshape(THUMBNAIL, cells, THUMBNAIL, cells, 3)
    mean = tiles.mean(axis=1).mean(axis=2)
    # Every second pixel and its neighbour to the right tell as much as all.
    left, right = seen[-1, ::2, ::2].astype(np.int16), seen[-1, ::2, 1::2]
    fineness = np.abs(left - right).mean(axis=0).mean(axis=0) / 255
    changes = np.abs(np.diff(small, axis=0)).mean(axis=(1, 2, 3))
    red, green, blue = np.moveaxis(np.abs(small[-1] - small[0]), -1, 0)
    moved = np.maximum(np.maximum(red, green), blue)
    share = float(np.count_nonzero(moved * 255 >= MOVED_LEVELS)) / moved.size
    texture = np.log(np.concatenate([fineness, changes, [share]]) + FLOOR)
    return FrameStats(mean.ravel(), texture.astype(np.float32), float(moved.max()) * 255)


@dataclass(frozen=True)
class OodDetector:
    """Statistics of training frames: a Gaussian for every kind of scene."""

    thumbnail: Float32[np.ndarray, "kinds 192"]
    """Mean."""
    components: Float32[np.ndarray, "kinds parts 192"]
    """Principal components of the thumbnails, orthonormal."""
    mean: Float32[np.ndarray, "kinds numbers"]
    """Statistics: parts along the components, the unexplained rest, the texture."""
    whitening: Float32[np.ndarray, "kinds numbers numbers"]
    """Whitening matrix, which turns differences from the mean into ones of unit covariance."""

    def score(self, seen: FrameStats) -> float:
        """Distance from the nearest kind; about 1 is usual."""
        return float(min(self.scores(seen)))

    def scores(self, seen: FrameStats) -> Float64[np.ndarray, " kinds"]:
        """Distance from every kind: root of the mean square of the whitened numbers."""
        numbers = summed_up(seen, self.thumbnail, self.components) - self.mean
        whitened = (self.whitening @ numbers[..., None])[..., 0]
        return np.sqrt(np.mean(whitened.astype(np.float64) ** 2, axis=-1))

    @classmethod
    def read(cls, path: Path) -> "OodDetector":
        """Read a file that :meth:`write` has written."""
        with np.load(path) as file:
            return cls(**{name: file[name] for name in file.files})

    def write(self, path: Path) -> None:
        """Write NumPy's compressed archive."""
        np.savez_compressed(path, allow_pickle=False, **asdict(self))


def summed_up(
    seen: FrameStats,
    thumbnail: Float32[np.ndarray, "*kinds 192"],
    components: Float32[np.ndarray, "*kinds parts 192"],
) -> Float32[np.ndarray, "*kinds numbers"]:
    """Return the numbers of a look: along the components, the unexplained rest, the texture.

    Parameters
    ----------
    thumbnail
        Mean of the training's thumbnails.
    components
        Their principal components, orthonormal.
    """
    difference = seen.thumbnail - thumbnail
    parts = (components @ difference[..., None])[..., 0]
    rest = difference - (parts[..., None, :] @ components)[..., 0, :]
    numbers = np.empty((*parts.shape[:-1], parts.shape[-1] + 1 + len(seen.texture)), np.float32)
    numbers[..., : parts.shape[-1]] = parts
    numbers[..., parts.shape[-1]] = np.log(np.linalg.norm(rest, axis=-1) + FLOOR)
    numbers[..., parts.shape[-1] + 1 :] = seen.texture
    return numbers
