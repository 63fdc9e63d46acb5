"""Where the camera stands: the same scene nearer, turned, tilted, through a real lens, shaken."""

import math
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from rollcast.simulation.appearance import CameraPose
from training.data.painting.ground import SIZE

Border = Literal["plain", "mirrored", "replicated"]
"""Kind of picture where the paper's camera saw nothing: a given colour or picture, or the ground
mirrored at the border, or the pixels of the border drawn out."""

_BORDERS: dict[Border, int] = {
    "plain": cv2.BORDER_TRANSPARENT,
    "mirrored": cv2.BORDER_REFLECT_101,
    "replicated": cv2.BORDER_REPLICATE,
}
_HALF = SIZE / 2
_INVERSIONS = 6
"""Steps of the fixed-point iteration that undoes the lens; it converges by a third a step."""


def shaken(
    frames: UInt8[np.ndarray, "frames size size 3"], shifts: Float[np.ndarray, "frames 2"]
) -> UInt8[np.ndarray, "frames size size 3"]:
    """Shift the pictures by fractions of a pixel; borders are mirrored."""
    if not np.any(shifts):
        return frames
    return np.stack([
        cv2.warpAffine(
            frame, np.array([[1, 0, dx], [0, 1, dy]]), (SIZE, SIZE),
            flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101,
        )
        if dx or dy else frame
        for frame, (dx, dy) in zip(frames, shifts, strict=True)
    ])  # fmt: skip


def posed_points(
    points_px: Float[np.ndarray, "*batch 2"], pose: CameraPose
) -> Float[np.ndarray, "*batch 2"]:
    """Where points of the paper's picture are in that of a camera that stands elsewhere."""
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    centred = (np.asarray(points_px) - _HALF) / _HALF
    x, y = pose.scale * centred[..., 0], pose.scale * centred[..., 1]
    moved = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    moved = moved + np.asarray(pose.offset) / _HALF
    moved = moved / (1 + moved @ np.asarray(pose.tilt))[..., None]
    moved = moved * (1 + pose.distortion * np.sum(moved**2, axis=-1, keepdims=True))
    return _HALF + _HALF * moved


def unposed_points(
    points_px: Float[np.ndarray, "*batch 2"], pose: CameraPose
) -> Float[np.ndarray, "*batch 2"]:
    """Undo :func:`posed_points`."""
    seen = (np.asarray(points_px) - _HALF) / _HALF
    straight = seen
    if pose.distortion:
        for _ in range(_INVERSIONS):
            squared = np.sum(straight**2, axis=-1, keepdims=True)
            straight = seen / (1 + pose.distortion * squared)
    # p' = p / (1 + t p) gives p = p' / (1 - t p').
    straight = straight / (1 - straight @ np.asarray(pose.tilt))[..., None]
    moved = straight - np.asarray(pose.offset) / _HALF
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y = moved[..., 0] / pose.scale, moved[..., 1] / pose.scale
    return _HALF + _HALF * np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def posed_frames(
    frames: UInt8[np.ndarray, "frames size size 3"],
    pose: CameraPose,
    beyond: UInt8[np.ndarray, "*place 3"],
    border: Border,
) -> UInt8[np.ndarray, "frames size size 3"]:
    """Show frames from a camera that stands elsewhere.

    Parameters
    ----------
    beyond
        Picture or colour of a plain border.
    """
    centres = np.arange(SIZE, dtype=np.float64) + 0.5
    grid = np.stack(np.meshgrid(centres, centres), axis=-1)
    at = (unposed_points(grid, pose) - 0.5).astype(np.float32)
    empty = np.broadcast_to(beyond, frames.shape[1:])
    return np.stack([
        cv2.remap(frame, at[..., 0], at[..., 1], cv2.INTER_LINEAR, empty.copy(), _BORDERS[border])
        for frame in frames
    ])  # fmt: skip


def posed_ground(
    ground: Float[np.ndarray, "3 cells cells"], pose: CameraPose
) -> Float[np.ndarray, "3 cells cells"]:
    """Map of the ground as a camera sees it; NaN where it is not known."""
    cells = ground.shape[-1]
    if not pose.is_similarity:
        return np.full_like(ground, np.nan)
    size = SIZE / cells
    centres = (np.arange(cells) + 0.5) * size
    grid = np.stack(np.meshgrid(centres, centres), axis=-1)
    at = (unposed_points(grid, pose) / size - 0.5).astype(np.float32)
    moved = np.stack([
        cv2.remap(
            layer.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )
        for layer in ground
    ])  # fmt: skip
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y, height = moved
    return np.stack([cos * x - sin * y, sin * x + cos * y, pose.scale * height])
