"""Batches that teach a perception of any number of balls.

Balls are padded to :data:`MOST_BALLS`. Lengths are halves of the frame in image axes (x right, y
down, z towards the camera), unknown values are NaN and have no loss.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

MOST_BALLS = 8


class BallWindow(NamedTuple):
    """Frames of one window with the true states of N balls."""

    frames: UInt8[np.ndarray, "seen 128 128 3"]
    places: Float[np.ndarray, "balls seen 2"]
    """Positions of the balls in the frames, with the shake of the picture."""
    radii: Float[np.ndarray, " balls"]
    visible: Float[np.ndarray, "balls seen"]
    """Visible fractions of the balls."""
    moving: Float[np.ndarray, " balls"]
    """Motion: 1 for moving balls, 0 for resting ones."""
    centres: Float[np.ndarray, "balls steps 3"]
    """Centres from t = -3 to the last step, one forecast step apart, without the shake."""
    spins: Float[np.ndarray, "balls steps 3"]
    """Angular velocities in rad/s from t = 0 to the last step."""
    ground: Float[np.ndarray, "3 cells cells"]
    """Map of :func:`training.data.rest_height_map.resting_ground`."""
    scene: Float[np.ndarray, "2"]
    """Constants of :func:`training.networks.perception.scene_constants_of`, for the first ball."""
    spacing: float = 1.0
    """Time between two seen frames, in those of a forecast; ``centres`` have one of a forecast."""


class BallBatch(NamedTuple):
    """Windows side by side; balls that are not there are NaN, ``there`` is 0."""

    frames: Tensor
    places: Tensor
    radii: Tensor
    visible: Tensor
    moving: Tensor
    centres: Tensor
    spins: Tensor
    ground: Tensor
    scene: Tensor
    spacing: Tensor
    """Spacings [B]."""
    there: Tensor
    """Mask [B, M] of balls."""


def collate(windows: Sequence[BallWindow]) -> BallBatch:
    """Stack windows, their balls padded."""
    padded = {
        name: torch.stack([_padded(getattr(window, name)) for window in windows])
        for name in ("places", "radii", "visible", "moving", "centres", "spins")
    }
    return BallBatch(
        frames=torch.from_numpy(np.stack([window.frames for window in windows])),
        ground=torch.from_numpy(np.stack([w.ground for w in windows]).astype(np.float32)),
        scene=torch.from_numpy(np.stack([w.scene for w in windows]).astype(np.float32)),
        spacing=torch.tensor([window.spacing for window in windows]),
        there=(~padded["radii"].isnan()).float(),
        **padded,
    )


def _padded(array: np.ndarray) -> Tensor:
    full = np.full((MOST_BALLS, *array.shape[1:]), np.nan, np.float32)
    full[: len(array)] = array
    return torch.from_numpy(full)
