"""The refiner: patches around one ball, all seen frames, to its places to fractions of a sample.

Places are measured in three ways. A convolution over all frames side by side regresses the
centre. Registration measures the displacement of the texture between neighbouring frames: one step
of Gauss and Newton (Lucas and Kanade) on learned features, weighted by a learned mask. The outline
fits a circle to the ball's edge. Registration is the most exact one for plain balls, and is biased
where the texture turns; the outline does not depend on the texture, and is inexact where the edge
is hidden or blurred. A perceptron weighs them for every pair of frames.

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

RAYS, RAY_SAMPLES = 24, 13
"""Rays along which the edge of a ball is located, and samples of each."""

SMALLEST_REACH = 6 / PATCH_SIZE
"""Shortest half of a ray, which reaches half a radius to either side of the rough edge."""

RIDGE = 0.01
"""Ridge of the circle's fit; its matrix has 0.5 on the diagonal where all rays weigh the same."""

DAMPING = 0.02
SMALLEST_CONTRAST = 0.04
"""Standard deviation of intensities -1 to 1 below which a patch's contrast is not stretched."""


class Refined(NamedTuple):
    """Outputs for patches around M balls."""

    rough: Tensor
    """Offsets [M, K, 2] of the centre from that of the patch in every frame, by convolution only;
    for the loss."""
    outline: Tensor
    """Offsets [M, K, 2] by the circle that fits the edge of the ball; for the loss."""
    edges: Tensor
    """Logits [M, K, RAYS, RAY_SAMPLES] of the edge on every ray; for the loss."""
    reach: Tensor
    """Half lengths [M] of the rays."""
    offsets: Tensor
    """Offsets [M, K, 2], the final estimate."""
    log_radius: Tensor
    """Logarithms [M] of the radius relative to half the width of the patch."""
    visible: Tensor
    """Logits [M, K] of visibility."""
    log_sigmas: Tensor
    """Logarithms [M, 2] of the standard deviations of last offset and displacement."""
    features: Tensor
    """Features [M, FEATURES] for the motion."""


class Registration(nn.Module):
    """Displacement between the patches of neighbouring frames, at two scales.

    The step solves A d = b over the ball: A sums the products of the features' gradients, b those
    of gradients and changes, so d is exact for small displacements of a constant appearance.
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


class Outline(nn.Module):
    """Least-squares circle through the edge of a ball, in every frame.

    The patches are sampled along rays from the rough centre, around the rough radius. A convolution
    over rays and radii locates the edge e(a) on the ray at angle a and weighs the rays. The
    correction (x, y) of the centre and r of the radius minimise the weighted sum of the squares
    (x cos a + y sin a + r - e(a))^2.
    """

    directions: Tensor
    steps: Tensor

    statistics = 3

    def __init__(self) -> None:
        super().__init__()
        hidden = 32
        self.layers = nn.ModuleList(
            nn.Conv2d(channels, hidden, 3, padding=(0, 1))
            for channels in (3 * OBSERVED_FRAMES, hidden, hidden)
        )
        self.context = nn.Linear(256, hidden)
        self.edges = nn.Conv2d(hidden, 2 * OBSERVED_FRAMES, 1)
        nn.init.zeros_(self.edges.weight)
        assert self.edges.bias is not None
        nn.init.zeros_(self.edges.bias)
        angles = torch.arange(RAYS) * (2 * torch.pi / RAYS)
        directions = torch.stack([angles.cos(), angles.sin()], dim=-1)
        self.register_buffer("directions", directions, persistent=False)
        self.register_buffer("steps", torch.linspace(-1, 1, RAY_SAMPLES), persistent=False)

    def forward(
        self, patches_MK3PP: Tensor, rough_MK2: Tensor, radius_M: Tensor, seen_M256: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Corrections [M, K, 2] of the rough centres, statistics [M, K, statistics], edges, reach.

        The last two are those of :class:`Refined`.
        """
        reach = (radius_M / 2).clamp(min=SMALLEST_REACH)
        radii = radius_M[:, None] + reach[:, None] * self.steps
        rays = radii[:, None, :, None] * self.directions[:, None]
        points = (rough_MK2[:, :, None, None] + rays[:, None]).flatten(0, 1)
        samples = functional.grid_sample(
            patches_MK3PP.flatten(0, 1), points, padding_mode="border", align_corners=False
        )
        said = samples.unflatten(0, patches_MK3PP.shape[:2]).flatten(1, 2)
        for number, layer in enumerate(self.layers):
            # The last ray is the neighbour of the first one.
            said = layer(torch.cat([said[:, :, -1:], said, said[:, :, :1]], dim=2))
            if number == 0:
                said = said + self.context(seen_M256)[..., None, None]
            said = said.relu()
        where, weight = self.edges(said).float().unflatten(1, (2, OBSERVED_FRAMES)).unbind(1)
        with full_precision(said.device):
            edge = (where.softmax(dim=-1) * self.steps).sum(dim=-1) * reach[:, None, None]
            fit = self.fitted(edge, functional.softplus(weight.mean(dim=-1)))
        return *fit, where, reach

    def fitted(self, edge_MKA: Tensor, weight_MKA: Tensor) -> tuple[Tensor, Tensor]:
        """Fit circles to edges along the rays, relative to the rough radius."""
        total = weight_MKA.sum(dim=-1, keepdim=True) + 1e-3
        share = weight_MKA / total
        # Subtracting the weighted means eliminates the radius.
        mean = (share[..., None] * self.directions).sum(dim=-2, keepdim=True)
        x, y = (self.directions - mean).unbind(-1)
        off = edge_MKA - (share * edge_MKA).sum(dim=-1, keepdim=True)

        def summed(one: Tensor, other: Tensor) -> Tensor:
            return (share * one * other).sum(dim=-1)

        xx, xy, yy = summed(x, x) + RIDGE, summed(x, y), summed(y, y) + RIDGE
        bx, by = summed(x, off), summed(y, off)
        determinant = xx * yy - xy * xy
        centre = torch.stack([yy * bx - xy * by, xx * by - xy * bx], dim=-1)
        centre = centre / determinant[..., None]
        left = off - x * centre[..., :1] - y * centre[..., 1:]
        parts = total[..., 0], summed(left, left) + 1e-5, determinant
        return centre, 0.3 * torch.stack(parts, dim=-1).log()


class PatchRefiner(nn.Module):
    """Network from the patches of a ball in all frames to its positions, radius and features."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = patch_layers(PATCH_SIZE)
        self.correction = nn.Linear(256, 2 * OBSERVED_FRAMES)
        self.features = nn.Linear(256, FEATURES)
        self.registration = Registration()
        seen = 256 + PAIRS * Registration.statistics
        self.weighing = nn.Sequential(nn.Linear(seen, 96), nn.ReLU(), nn.Linear(96, PAIRS * 5))
        self.outline = Outline()
        fitted = seen + OBSERVED_FRAMES * Outline.statistics + 2 * PAIRS
        self.outline_weighing = nn.Sequential(
            nn.Linear(fitted, 96), nn.ReLU(), nn.Linear(96, PAIRS + 1)
        )
        self.radius_and_visibility = nn.Linear(256, 1 + OBSERVED_FRAMES)
        self.sigmas = nn.Sequential(nn.Linear(seen, 64), nn.ReLU(), nn.Linear(64, 2))
        for last in (
            self.correction, self.weighing[-1], self.outline_weighing[-1],
            self.radius_and_visibility, self.sigmas[-1],
        ):  # fmt: skip
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
            last = self.outline_weighing[-1]
            assert isinstance(last, nn.Linear)
            last.bias.fill_(-2.0)

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
        values = self.radius_and_visibility(seen).float()
        sigmas = self.sigmas(known.detach()).float()
        features = self.features(seen).float()
        offsets = self.correction(seen).float().unflatten(-1, (OBSERVED_FRAMES, 2))
        offsets = offsets / PATCH_HALF_WIDTH
        log_radius = values[:, 0].clamp(-3, 1) - torch.log(torch.tensor(WIDTH_IN_RADII))
        # The loss of the outline trains neither the rough centre nor the radius.
        rough, radius = offsets.detach(), log_radius.detach().exp()
        correction, fit, edges, reach = self.outline(stretched, rough, radius, seen)
        outline = rough + correction
        read, shifted = (part[:, 1:] - part[:, :-1] for part in (offsets, outline))
        ways = torch.cat([read[:, None], registered], dim=1)
        weights = said[..., :3].softmax(dim=-1).permute(0, 2, 1)[..., None]
        moved = (weights * ways).sum(dim=1) + 0.1 * said[..., 3:]
        unlike = 10 * (moved - shifted).detach()
        known = torch.cat([known, fit.flatten(1), unlike.flatten(1)], dim=-1)
        share = self.outline_weighing(known).float().sigmoid()[..., None]
        moved = moved + share[:, :PAIRS] * (shifted - moved)
        middle = offsets.mean(dim=1, keepdim=True)
        middle = middle + share[:, PAIRS:] * (outline.mean(dim=1, keepdim=True) - middle)
        passed = torch.cat([torch.zeros_like(moved[:, :1]), moved.cumsum(dim=1)], dim=1)
        passed = passed - passed.mean(dim=1, keepdim=True)
        exact = middle + passed
        return Refined(
            offsets, outline, edges, reach, exact, log_radius, values[:, 1:], sigmas.clamp(-8, 2),
            features,
        )  # fmt: skip
