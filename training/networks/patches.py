"""Patches around balls as tensors: the same samples as :func:`rollcast.patches.cut_patches`."""

import torch
from torch import Tensor

from rollcast.patches import PATCH_SIZE, SMALLEST_HALF_WIDTH, WIDTH_IN_RADII


def half_widths(radii: Tensor) -> Tensor:
    """Half widths of the patches around balls of some radii, halves of the square."""
    return (WIDTH_IN_RADII * radii).clamp(min=SMALLEST_HALF_WIDTH)


def cut_patches(frames_BKHW3: Tensor, centres_BNK2: Tensor, widths_BN: Tensor) -> Tensor:
    """Cut patches [B, N, K, 3, P, P], intensities -1 to 1, out of square frames.

    Parameters
    ----------
    centres_BNK2
        Points of the square.
    widths_BN
        Half widths, halves of the square.
    """
    size = frames_BKHW3.shape[2]
    batch, balls, frames = centres_BNK2.shape[:3]
    along = (torch.arange(PATCH_SIZE, device=centres_BNK2.device) + 0.5) * (2 / PATCH_SIZE) - 1
    points = centres_BNK2[..., None] + widths_BN[:, :, None, None, None] * along
    at = ((points + 1) * (size / 2) - 0.5).clamp(0, size - 1)
    reach = (widths_BN * (size / PATCH_SIZE)).clamp(min=1)[:, :, None, None, None, None]
    pixels = torch.arange(size, device=at.device)
    weights = (1 - (pixels - at[..., None]).abs() / reach).clamp(min=0)
    weights = weights / weights.sum(dim=-1, keepdim=True)
    across, down = weights.transpose(1, 2).unbind(3)
    # One product a frame serves all balls: [B, K, N P, H] x [B, K, H, W 3].
    lines = down.flatten(2, 3) @ frames_BKHW3.float().flatten(3)
    lines = lines.reshape(batch, frames, balls, PATCH_SIZE, size, 3)
    patches = across[:, :, :, None] @ lines
    return patches.permute(0, 2, 1, 5, 3, 4) / 127.5 - 1
