"""The refiner: patches around one ball, all seen frames, to its places to fractions of a sample.

Places are read twice. A convolution over all frames side by side says where the ball's centre is;
registration says how far what is on the ball has gone between neighbouring frames: one step of
Gauss and Newton (Lucas and Kanade) on learned features, weighted by a learned mask. Registration
is the more exact one where a ball is plain, and fails where its texture turns, so a perceptron
weighs them for every pair of frames.

Everything is relative to the patch: lengths are its half widths.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from rollcast.patches import PATCH_SIZE, WIDTH_IN_RADII
from rollcast.trajectory import OBSERVED_FRAMES
from training.common.precision import full_precision
from training.networks.blocks import cell_centres
from training.networks.perception import FEATURES, PATCH_HALF_WIDTH, patch_layers

PAIRS = OBSERVED_FRAMES - 1
LEARNED = 5
"""Channels of learned features beside the colours that registration compares."""

DAMPING = 0.02
SMALLEST_CONTRAST = 0.04
"""Standard deviation of intensities -1 to 1 below which a patch's contrast is not stretched."""


class Refined(NamedTuple):
    """What patches around M balls show."""

    rough: Tensor
    """[M, K, 2] of the ball's centre from that of the patch in every frame, by convolution alone;
    for the loss."""
    offsets: Tensor
    """[M, K, 2] the same, as exact as can be."""
    log_radius: Tensor
    """[M] of the ball's radius over the patch's half width."""
    visible: Tensor
    """[M, K] logits: whether the ball is seen there."""
    log_sigmas: Tensor
    """[M, 2]: standard deviations of the last offset and of the last displacement, logarithms."""
    features: Tensor
    """[M, FEATURES]: what else the patches show."""


class Registration(nn.Module):
    """Displacement between the patches of neighbouring frames, at two scales.

    The step solves A d = b over the ball: A sums the products of the features' gradients, b those
    of gradients and changes, so d is exact for small displacements of what does not change.
    """

    disc: Tensor

    statistics = 2 * 6

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3, 12, 3, padding=1), nn.ReLU(), nn.Conv2d(12, LEARNED + 1, 3, padding=1)
        )
        distance = cell_centres(PATCH_SIZE).norm(dim=0) * WIDTH_IN_RADII
        # Where a ball of the patch's own width would be, a little beyond its edge.
        self.register_buffer("disc", 6 * (1.15 - distance), persistent=False)

    def forward(self, patches_MK3PP: Tensor) -> tuple[Tensor, Tensor]:
        """Displacements [M, 2, PAIRS, 2] at both scales and statistics [M, PAIRS, statistics]."""
        said = self.features(patches_MK3PP.flatten(0, 1)).unflatten(0, patches_MK3PP.shape[:2])
        with full_precision(patches_MK3PP.device):
            said = said.float()
            mask = (said[:, :, LEARNED:] + self.disc).sigmoid()
            known = torch.cat([patches_MK3PP.float(), said[:, :, :LEARNED]], dim=2)
            found = [self._register(known, mask, 1)]
            known, mask = (
                functional.avg_pool2d(part.flatten(0, 1), 2).unflatten(0, part.shape[:2])
                for part in (known, mask)
            )
            found.append(self._register(known, mask, 2))
            shifts, statistics = zip(*found, strict=True)
            return torch.stack(shifts, dim=1), torch.cat(statistics, dim=-1)

    def _register(self, known: Tensor, mask: Tensor, pooled: int) -> tuple[Tensor, Tensor]:
        """Displacements [M, PAIRS, 2] and statistics [M, PAIRS, 6]."""
        earlier, later = known[:, :-1], known[:, 1:]
        middle, change = (earlier + later) / 2, (earlier - later)[..., 1:-1, 1:-1]
        right = (middle[..., 1:-1, 2:] - middle[..., 1:-1, :-2]) / 2
        down = (middle[..., 2:, 1:-1] - middle[..., :-2, 1:-1]) / 2
        weight = (mask[:, :-1] * mask[:, 1:])[..., 1:-1, 1:-1]
        area = weight.sum(dim=(-3, -2, -1)) + 1

        def summed(one: Tensor, other: Tensor) -> Tensor:
            return (weight * one * other).sum(dim=(-3, -2, -1)) / area

        xx, xy, yy = summed(right, right), summed(right, down), summed(down, down)
        bx, by, changed = summed(right, change), summed(down, change), summed(change, change)
        damping = DAMPING * (xx + yy) / 2 + 1e-4
        xx, yy = xx + damping, yy + damping
        determinant = xx * yy - xy * xy
        samples = torch.stack([yy * bx - xy * by, xx * by - xy * bx], dim=-1)
        samples = (samples / determinant[..., None]).clamp(-4, 4)
        explained = samples[..., 0] * bx + samples[..., 1] * by
        statistics = torch.stack(
            [
                samples[..., 0] / 2, samples[..., 1] / 2, 0.3 * (xx + yy).log(),
                0.3 * determinant.log() - 0.3 * (xx + yy).log(), 0.3 * (changed + 1e-4).log(),
                explained / (changed + 1e-4),
            ],
            dim=-1,
        )  # fmt: skip
        return samples * (2 * pooled / PATCH_SIZE), statistics


class PatchRefiner(nn.Module):
    """Patches of balls, all frames of one side by side, to what they show of it."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = patch_layers(PATCH_SIZE)
        self.correction = nn.Linear(256, 2 * OBSERVED_FRAMES)
        self.features = nn.Linear(256, FEATURES)
        self.registration = Registration()
        seen = 256 + PAIRS * Registration.statistics
        self.weighing = nn.Sequential(nn.Linear(seen, 96), nn.ReLU(), nn.Linear(96, PAIRS * 5))
        self.looks = nn.Linear(256, 1 + OBSERVED_FRAMES)
        self.sigmas = nn.Sequential(nn.Linear(seen, 64), nn.ReLU(), nn.Linear(64, 2))
        for last in (self.correction, self.weighing[-1], self.looks, self.sigmas[-1]):
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        with torch.no_grad():
            last = self.weighing[-1]
            assert isinstance(last, nn.Linear)
            last.bias.unflatten(0, (PAIRS, 5))[:, 0] = 2.0
            last = self.sigmas[-1]
            assert isinstance(last, nn.Linear)
            last.bias.fill_(-3.0)

    def forward(self, patches_MK3PP: Tensor) -> Refined:
        """Read patches [M, K, 3, P, P] of M balls, intensities -1 to 1."""
        stacked = patches_MK3PP.flatten(1, 2)
        seen = self.layers(stacked.contiguous(memory_format=torch.channels_last))
        contrast = patches_MK3PP.flatten(1).std(dim=1).clamp(min=SMALLEST_CONTRAST)
        mean = patches_MK3PP.mean(dim=(1, 3, 4), keepdim=True)
        stretched = (patches_MK3PP - mean) / contrast[:, None, None, None, None]
        registered, statistics = self.registration(stretched)
        known = torch.cat([seen.float(), statistics.flatten(1)], dim=-1)
        said = self.weighing(known).float().unflatten(-1, (PAIRS, 5))
        looks = self.looks(seen).float()
        sigmas = self.sigmas(known.detach()).float()
        features = self.features(seen).float()
        offsets = self.correction(seen).float().unflatten(-1, (OBSERVED_FRAMES, 2))
        offsets = offsets / PATCH_HALF_WIDTH
        read = offsets[:, 1:] - offsets[:, :-1]
        ways = torch.cat([read[:, None], registered], dim=1)
        weights = said[..., :3].softmax(dim=-1).permute(0, 2, 1)[..., None]
        moved = (weights * ways).sum(dim=1) + 0.1 * said[..., 3:]
        passed = torch.cat([torch.zeros_like(moved[:, :1]), moved.cumsum(dim=1)], dim=1)
        passed = passed - passed.mean(dim=1, keepdim=True)
        exact = offsets.mean(dim=1, keepdim=True) + passed
        log_radius = looks[:, 0].clamp(-3, 1) - torch.log(torch.tensor(WIDTH_IN_RADII))
        return Refined(offsets, exact, log_radius, looks[:, 1:], sigmas.clamp(-8, 2), features)
