"""Losses of the perception of any number of balls: heat, votes, outputs of patches."""

import torch
from torch import Tensor
from torch.nn import functional

from rollcast.trajectory import OBSERVED_FRAMES
from training.data.ball_batch import BallBatch
from training.networks.any_ball import Beginning, Seen
from training.networks.ball_detector import MAP_CELLS, PIXEL, BallMaps
from training.networks.blocks import PIXEL_UNIT, cell_centres
from training.networks.perception import sampled
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT
from training.objectives.losses import known_difference, smooth_distance

CELL = 2 / MAP_CELLS
MOST_HIDDEN = 0.5
"""Hidden fraction in the last frame above which a ball has no loss."""


class DetectionLoss:
    """Maps of a detector against the balls that are there.

    The heat is a focal loss as in CenterNet (Zhou et al. 2019) with Gaussians around the centres;
    every cell within a ball, and at least within a cell's side of its centre, votes.
    """

    heat = 3.0
    places = 1.0
    radius = 1.0
    moving = 1.0
    ground = 10.0
    way = 15.0
    scene = 2.0

    def __call__(self, maps: BallMaps, batch: BallBatch) -> dict[str, Tensor]:
        """Parts of the loss by name, weighted."""
        last = batch.places[:, :, -1].nan_to_num(9.0)
        radii = batch.radii.nan_to_num(PIXEL)
        asked = batch.there * (batch.visible[:, :, -1].nan_to_num() > MOST_HIDDEN)
        cells = cell_centres(MAP_CELLS).to(last.device)
        apart = (cells - last[..., None, None]).norm(dim=2)
        reach = torch.maximum(radii, torch.tensor(CELL))[..., None, None]
        nearness = torch.where(batch.there[..., None, None] > 0, apart / reach, torch.inf)
        nearest = nearness.min(dim=1)
        voters = (nearest.values < 1).float()
        count = voters.sum() + 1

        def of_nearest(values: Tensor) -> Tensor:
            """Values [B, M, ...] of the ball nearest to every cell: [B, G, G, ...]."""
            flat = nearest.indices.flatten(1)
            index = flat.reshape(*flat.shape, *(1 for _ in values.shape[2:]))
            chosen = values.gather(1, index.expand(-1, -1, *values.shape[2:]))
            return chosen.unflatten(1, nearest.indices.shape[1:])

        truth = of_nearest(batch.places.nan_to_num()).permute(0, 3, 4, 1, 2)
        off = smooth_distance(PIXEL_UNIT * (maps.places - truth).movedim(2, -1), 0.5)
        size = of_nearest(radii)
        # A pixel matters more of a small ball.
        off = off * (6 * PIXEL / size).clamp(1, 3)[:, None]
        unlike = (maps.log_radius - size.log()).abs()
        moves = functional.binary_cross_entropy_with_logits(
            maps.moving, of_nearest(batch.moving.nan_to_num()), reduction="none"
        )
        return {
            "heat": self.heat * self._heat(maps.heat, last, radii, batch.there, asked),
            "votes": self.places * (off.mean(dim=1) * voters).sum() / count,
            "vote radius": self.radius * (unlike * voters).sum() / count,
            "moving": self.moving * (moves * voters).sum() / count,
            **self._scene_losses(maps, batch),
        }

    def _heat(
        self, heat: Tensor, last: Tensor, radii: Tensor, there: Tensor, asked: Tensor
    ) -> Tensor:
        cells = cell_centres(MAP_CELLS).to(heat.device)
        apart = (cells - last[..., None, None]).norm(dim=2)
        sigma = (radii / 3).clamp(1.2 * PIXEL, 5 * PIXEL)[..., None, None]
        blobs = torch.exp(-((apart / sigma) ** 2) / 2) * there[..., None, None]
        centre = ((last + 1) / CELL).floor().long()
        inside = ((centre >= 0) & (centre < MAP_CELLS)).all(dim=-1)
        flat = centre.clamp(0, MAP_CELLS - 1)
        flat = flat[..., 1] * MAP_CELLS + flat[..., 0]
        ones = torch.zeros_like(heat).flatten(1)
        ones = ones.scatter_reduce(1, flat, asked * inside, "amax").unflatten(1, heat.shape[1:])
        # Balls that are hidden or half outside are neither right nor wrong.
        unsure = ((apart < torch.maximum(radii, torch.tensor(CELL))[..., None, None]) & (
            (there * (1 - asked * inside))[..., None, None] > 0
        )).any(dim=1)  # fmt: skip
        likely = heat.sigmoid().clamp(1e-5, 1 - 1e-5)
        found = ones * (1 - likely) ** 2 * likely.log()
        others = (1 - ones) * (1 - blobs.amax(dim=1)) ** 4 * likely**2 * (1 - likely).log()
        missed = torch.where(unsure, 0.0, found + others)
        return -missed.sum() / (ones.sum() + 1)

    def _scene_losses(self, maps: BallMaps, batch: BallBatch) -> dict[str, Tensor]:
        ground, known = batch.ground, (~batch.ground.isnan()).float()
        off = torch.where(ground.isnan(), 0.0, maps.ground - ground.nan_to_num()).abs()
        points = batch.centres[..., :2].nan_to_num()
        way = sampled(maps.ground, points) - sampled(ground.nan_to_num(), points)
        sure = (sampled(known, points) > 0.999) & ~batch.centres[..., :1].isnan()
        there = (~batch.centres[..., 0].isnan()).sum() + 1
        scene = torch.where(batch.scene.isnan(), 0.0, maps.scene - batch.scene.nan_to_num())
        return {
            "ground": self.ground * off.sum(dim=1).mean(),
            "way": self.way * (way.abs() * sure).sum() / there,
            "scene": self.scene * scene.abs().mean(),
        }


class RefinementLoss:
    """Loss of the patch refiner's outputs and of the ball states at t = 0.

    The covariance loss has no gradient with respect to the positions.
    """

    rough = 1.0
    outline = 2.0
    edges = 1.0
    places = 3.0
    displacement = 2.0
    radius = 1.0
    visible = 0.5
    covariance = 0.2
    height = 0.5
    velocity = 3.0
    spin = 0.3
    rounding = 0.1
    outlier = 4.0

    def __call__(self, seen: Seen, balls: Beginning, batch: BallBatch) -> dict[str, Tensor]:
        """Parts of the loss by name, weighted.

        Parameters
        ----------
        batch
            Of the balls that were looked at, see :func:`chosen`.
        """
        there, radii = batch.there, batch.radii.nan_to_num(PIXEL)
        # A pixel matters more of a small ball: it may be many of the frame that is sent.
        weight = there * (6 * PIXEL / radii).clamp(1, 3)
        count = there.sum() + 1
        visible = batch.visible.nan_to_num()
        truth = batch.places.nan_to_num()
        off = seen.places - truth
        moved = off[:, :, 1:] - off[:, :, :-1]
        both = visible[:, :, 1:] * visible[:, :, :-1]
        placed = (self._pixels(off) * visible).mean(dim=-1)
        shifted = (self._pixels(moved) * both).mean(dim=-1) + self._pixels(moved[:, :, -1])
        unlike = (seen.radii.log() - radii.log()).abs()
        hidden = functional.binary_cross_entropy_with_logits(
            seen.visible, visible, reduction="none"
        ).mean(dim=-1)
        rough, outline = (
            (weight * (self._pixels(places - truth) * visible).mean(dim=-1)).sum() / count
            for places in (seen.rough, seen.outline)
        )
        parts = {
            "rough": self.rough * rough,
            "outline": self.outline * outline,
            "edges": self.edges * (there * self._edges(seen, truth, radii, visible)).sum() / count,
            "places": self.places * (weight * placed).sum() / count,
            "displacements": self.displacement * (weight * shifted).sum() / count,
            "radius": self.radius * (there * unlike).sum() / count,
            # Patches without a ball train only the visibility.
            "visible": self.visible * hidden.mean(),
            "covariance": self.covariance * (there * self._nll(seen, off)).sum() / count,
        }
        return parts | self._beginning(balls, batch, count)

    def _edges(self, seen: Seen, truth: Tensor, radii: Tensor, visible: Tensor) -> Tensor:
        """Cross entropy [B, N] of the edges along the rays of the outline."""
        rays, samples = seen.edges.shape[-2:]
        angles = torch.arange(rays) * (2 * torch.pi / rays)
        directions = torch.stack([angles.cos(), angles.sin()], dim=-1).to(truth)
        centre = (truth - seen.rough.detach())[..., None, :]
        along = (centre * directions).sum(dim=-1)
        # Where a ray that begins within the circle leaves it.
        left = radii[..., None, None] ** 2 - centre.square().sum(dim=-1) + along.square()
        edge = along + left.clamp(min=0).sqrt() - seen.radii.detach()[..., None, None]
        at = (edge / seen.reach[..., None, None] + 1) * ((samples - 1) / 2)
        known = ((at >= 0) & (at <= samples - 1) & (left > 0)) * visible[..., None]
        low = at.clamp(0, samples - 1.001).floor()
        share = at.clamp(0, samples - 1) - low
        likely = seen.edges.log_softmax(dim=-1)
        low = low.long()[..., None]
        lower, upper = (likely.gather(-1, low + step)[..., 0] for step in (0, 1))
        missed = -(1 - share) * lower - share * upper
        return (missed * known).mean(dim=(-2, -1))

    def _beginning(self, balls: Beginning, batch: BallBatch, count: Tensor) -> dict[str, Tensor]:
        now, before = (batch.centres[:, :, OBSERVED_FRAMES - 1 - back] for back in (0, 1))
        off = known_difference(balls.centres, now)
        hasty = known_difference(balls.velocities, now - before)
        height = PIXEL_UNIT * off[..., 2].abs()
        spins = ANGULAR_VELOCITY_UNIT * balls.spins
        truth = batch.spins[:, :, 0]
        turned = smooth_distance(known_difference(spins, truth), 0.5)
        turned = turned / (1 + truth.nan_to_num().norm(dim=-1) / ANGULAR_VELOCITY_UNIT)
        # Height is known of simulated scenes alone; their number changes from batch to batch.
        return {
            "centres": (self._pixels(off[..., :2]) + self.height * height).sum() / count,
            "velocities": self.velocity * self._pixels(hasty).sum() / count,
            "spins": self.spin * turned.sum() / count,
        }

    def _nll(self, seen: Seen, off: Tensor) -> Tensor:
        last, before = off[:, :, -1].detach(), off[:, :, -2].detach()
        errors = torch.stack([last, last - before], dim=2).square().sum(dim=-1)
        sigmas = seen.log_sigmas
        squared = errors * torch.exp(-2 * sigmas)
        limit = self.outlier
        linear = 2 * limit * squared.clamp(min=limit**2).sqrt() - limit**2
        return (0.5 * torch.where(squared < limit**2, squared, linear) + 2 * sigmas).mean(dim=-1)

    def _pixels(self, difference: Tensor) -> Tensor:
        return smooth_distance(PIXEL_UNIT * difference, self.rounding)


def chosen(batch: BallBatch, index_BR: Tensor) -> BallBatch:
    """Return the batch of some balls [B, R] of every window."""

    def of(values: Tensor) -> Tensor:
        index = index_BR.reshape(*index_BR.shape, *(1 for _ in values.shape[2:]))
        return values.gather(1, index.expand(-1, -1, *values.shape[2:]))

    per_ball = ("places", "radii", "visible", "moving", "centres", "spins", "there")
    return batch._replace(**{name: of(getattr(batch, name)) for name in per_ball})
