"""The detector of any number of balls: whole frames to maps, and their peaks to candidates.

Every cell within a ball votes for its centre, its places in the earlier frames, its radius and
whether it moves, so a prompt anywhere on a ball reads all of that too. Lengths are halves of the
frame in image axes (x right, y down).
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from rollcast.trajectory import OBSERVED_FRAMES
from training.networks.blocks import cell_centres
from training.networks.perception import CoarseDetector

CANDIDATES = 16
"""Peaks that are kept of a window."""

MAP_CELLS = 32
PIXEL = 1 / 64
"""A pixel of a 128-px frame."""

SMALLEST_RADIUS, LARGEST_RADIUS = 0.8 * PIXEL, 45 * PIXEL
USUAL_RADIUS = 6 * PIXEL
_RARE = -4.0
"""First logit of the heat: nearly no cell is a centre."""


class BallMaps(NamedTuple):
    """Outputs of the cells of the frame for the ball at the cell."""

    heat: Tensor
    """Logits [B, G, G] of the centre of a ball in the cell, in the last frame."""
    moving: Tensor
    """Logits [B, G, G] of motion."""
    places: Tensor
    """Centres [B, K, 2, G, G] in every observed frame."""
    log_radius: Tensor
    """Logarithms [B, G, G] of radii."""
    ground: Tensor
    """Ground maps [B, 3, G, G], see :mod:`training.data.rest_height_map`."""
    scene: Tensor
    """Scene constants [B, 2], see :func:`training.networks.perception.scene_constants_of`."""


class Candidates(NamedTuple):
    """Candidates of the detector."""

    places: Tensor
    """Positions [B, N, K, 2] in the observed frames."""
    radii: Tensor
    """Radii [B, N]."""
    scores: Tensor
    """Confidence [B, N] of presence, 0..1."""
    moving: Tensor
    """Confidence [B, N] of motion, 0..1."""


class BallDetector(CoarseDetector):
    """Frames to maps at a quarter of their resolution; its trunk is the coarse detector's."""

    cells: Tensor

    def __init__(self) -> None:
        super().__init__(objects=1)
        fine, middle, hidden = 48, 96, 48
        # The coarse detector's position of a single moving ball, at 16 x 16 cells, is an input.
        known = self.where.out_channels
        self.said_16 = nn.Conv2d(middle + known, hidden, 1)
        self.said_32 = nn.Conv2d(fine, hidden, 3, padding=1)
        self.said = nn.Sequential(nn.ReLU(), nn.Conv2d(hidden, 3 + 2 * OBSERVED_FRAMES, 1))
        last = self.said[-1]
        assert isinstance(last, nn.Conv2d)
        assert last.bias is not None
        nn.init.normal_(last.weight, std=1e-3)
        nn.init.zeros_(last.bias)
        nn.init.constant_(last.bias[:1], _RARE)
        self.register_buffer("cells", cell_centres(MAP_CELLS), persistent=False)

    def maps(self, frames_BKHW3: Tensor) -> BallMaps:
        """Look at the seen frames uint8 [B, 4, 128, 128, 3]."""
        ground, scene, at_32, at_16 = self.trunk(frames_BKHW3)
        near = self.said_16(torch.cat([at_16, self.where(at_16)], dim=1))
        near = functional.interpolate(near, scale_factor=2.0)
        said = self.said(self.said_32(at_32) + near).float()
        now = self.cells + 8 * PIXEL * said[:, 3:5]
        before = now[:, None] + 8 * PIXEL * said[:, 5:].unflatten(1, (OBSERVED_FRAMES - 1, 2))
        log_radius = said[:, 2].clamp(-3, 3) + torch.log(torch.tensor(USUAL_RADIUS))
        return BallMaps(
            said[:, 0], said[:, 1], torch.cat([before, now[:, None]], dim=1), log_radius,
            ground, scene,
        )  # fmt: skip


def peaks(maps: BallMaps) -> Candidates:
    """Return the cells that are hotter than their neighbours, the hottest first."""
    heat = maps.heat[:, None]
    highest = functional.max_pool2d(heat, 3, stride=1, padding=1)
    kept = torch.where(heat == highest, heat, torch.full_like(heat, -20.0)).flatten(1)
    scores, cells = kept.topk(CANDIDATES, dim=1)
    places = maps.places.flatten(3).permute(0, 3, 1, 2)
    chosen = cells[:, :, None, None].expand(-1, -1, *places.shape[2:])
    return Candidates(
        places.gather(1, chosen),
        _radii(maps.log_radius.flatten(1).gather(1, cells)),
        scores.sigmoid(),
        maps.moving.flatten(1).gather(1, cells).sigmoid(),
    )


def voted(maps: BallMaps, points_BN2: Tensor) -> Candidates:
    """Return the votes of the cells at points."""
    layers = torch.cat(
        [
            maps.places.flatten(1, 2), maps.log_radius[:, None],
            maps.heat[:, None], maps.moving[:, None],
        ],
        dim=1,
    )  # fmt: skip
    said = functional.grid_sample(
        layers, points_BN2[:, :, None], padding_mode="border", align_corners=False
    )[..., 0].transpose(1, 2)
    places = said[..., : 2 * OBSERVED_FRAMES].unflatten(-1, (OBSERVED_FRAMES, 2))
    rest = said[..., 2 * OBSERVED_FRAMES :]
    return Candidates(places, _radii(rest[..., 0]), rest[..., 1].sigmoid(), rest[..., 2].sigmoid())


def _radii(logarithms: Tensor) -> Tensor:
    return logarithms.exp().clamp(SMALLEST_RADIUS, LARGEST_RADIUS)
