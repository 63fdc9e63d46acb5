"""Trains the perception of any number of balls."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.common.precision import full_precision, mixed_precision
from training.data.ball_batch import BallBatch
from training.engine.loop import Optimisation, TrainerConfig, TrainingLoop
from training.networks.any_ball import AnyBallNet
from training.networks.ball_detector import PIXEL, BallMaps, peaks, voted
from training.networks.blocks import PIXEL_UNIT
from training.networks.patches import half_widths
from training.networks.recurrent import State
from training.objectives.detection import DetectionLoss, RefinementLoss, chosen
from training.objectives.losses import known_difference, smooth_distance, step_weights
from training.objectives.schedules import Cosine

ROUNDING = 0.5
"""Distance in pixels below which errors of trajectories are rounded off."""
VISIBLE = 0.3
"""Smallest visible share in the last frame of balls whose patches are read."""


@dataclass(frozen=True)
class BallTraining:
    """Configuration of a training of the perception, besides its data.

    Attributes
    ----------
    batches
        Budget.
    refined_per_window
        Balls per window, in the mean, whose patches are cut. With 0, the detector trains alone.
    trajectory
        Weight of the error of trajectories that begin with the states at t = 0, over ``horizon``
        steps; step ``halving`` has half the weight of the first. Only balls that meet no other one
        are rolled out.
    frozen
        Prefixes of the parameters that do not train. With ``perception.detector.`` among them, the
        refiner and the states at t = 0 train alone, on several times as many balls in the time.
    """

    batches: int
    batch_size: int = 24
    refined_per_window: float = 1.3
    trajectory: float = 0.0
    horizon: int = 20
    halving: float = 10.0
    learning_rate: float = 8e-4
    gradient_clip: float = 4.0
    average_decay: float = 0.998
    seed: int = 1
    frozen: tuple[str, ...] = ("rolling.", "first_covariance.", "covariance_from_sigmas.")
    fresh: tuple[str, ...] = (
        "perception.detector.said",
        "perception.refiner.registration.",
        "perception.refiner.weighing.",
        "perception.refiner.radius_and_visibility.",
        "perception.refiner.sigmas.",
    )
    """Parts that start from random weights."""
    fresh_rate: float = 3.0
    """Learning rate of these parts, relative to all others."""


class BallTrainer(TrainingLoop[BallBatch]):
    """The training of the perception in a folder of its own.

    Parameters
    ----------
    stream
        Makes the batches from a number on; batch k is always the same.
    scenes
        Training scenes by kind, for the card of the model.
    validate
        Function that returns the error in px that selects the best weights, and errors to plot.
    """

    def __init__(
        self,
        network: AnyBallNet,
        training: BallTraining,
        folder: Path,
        stream: Callable[[int], IterableDataset[BallBatch]],
        scenes: Mapping[str, int],
        validate: Callable[[AnyBallNet], tuple[float, Mapping[str, float]]],
        config: TrainerConfig | None = None,
    ) -> None:
        torch.manual_seed(training.seed)
        self.network = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.training = training
        self._make_stream = stream
        self._scenes = dict(scenes)
        self._validate = validate
        rate = training.learning_rate
        groups: dict[float, list[torch.nn.Parameter]] = {rate: [], rate * training.fresh_rate: []}
        for name, parameter in network.named_parameters():
            parameter.requires_grad_(not name.startswith(training.frozen))
            if parameter.requires_grad:
                fresh = name.startswith(training.fresh)
                groups[rate * (training.fresh_rate if fresh else 1.0)].append(parameter)
        optimisation = Optimisation(
            training.batches,
            training.batch_size,
            lambda groups: torch.optim.AdamW(groups, rate, betas=(0.9, 0.95), weight_decay=0.01),
            Cosine,
            training.gradient_clip,
            training.average_decay,
        )
        super().__init__(
            network,
            [{"params": group, "lr": rate} for rate, group in groups.items()],
            optimisation,
            folder,
            config or TrainerConfig(),
        )
        self._detection, self._refinement = DetectionLoss(), RefinementLoss()

    def _stream(self) -> Iterator[BallBatch]:
        workers = self._config.workers
        ahead = 4 if workers else None
        stream = self._make_stream(self.batches)
        loader = DataLoader(stream, batch_size=None, num_workers=workers, prefetch_factor=ahead)
        return iter(loader)

    def _loss(self, batch: BallBatch, progress: float) -> Tensor:  # noqa: ARG002 - the base's
        return torch.stack(list(self.losses(batch).values())).sum()

    def _errors(self) -> tuple[float, Mapping[str, float]]:
        averaged = self.averaged()
        assert isinstance(averaged, AnyBallNet)
        return self._validate(averaged)

    def _best_weights(self) -> dict[str, Any]:
        return {
            "weights": self.averaged().state_dict(),
            "sequences": self.sequences,
            "scenes": self._scenes,
        }

    def losses(self, batch: BallBatch) -> dict[str, Tensor]:
        """Return the parts of the loss of a batch by name."""
        perception = self.network.perception
        detects = any(parameter.requires_grad for parameter in perception.detector.parameters())
        with mixed_precision(batch.places.device), torch.set_grad_enabled(detects):
            maps = perception.detector.maps(batch.frames)
        parts = self._detection(maps, batch) if detects else {}
        if not self.training.refined_per_window:
            return parts
        generator = torch.Generator().manual_seed(self.batches + 7919 * self.training.seed)
        rows = _rows(batch, self.training.refined_per_window, generator)
        balls, places, radii = _beginnings(batch, maps, rows, generator)
        with mixed_precision(batch.places.device):
            # The single pass is the first one of half of the balls, the second one of the others.
            seen = perception.refine(balls.frames, places, radii, passes=1)
        ground, spacing = maps.ground[rows.window], balls.spacing
        state, beginning = self.network.begin(seen, ground, maps.scene[rows.window], spacing)
        parts |= self._refinement(seen, beginning, balls)
        if self.training.trajectory:
            missed = self._trajectories(state, balls)
            alone = _alone(batch, rows)
            mean = (alone * missed).sum() / (alone.sum() + 1)
            parts["trajectories"] = self.training.trajectory * mean
        return parts

    def _trajectories(self, state: State, balls: BallBatch) -> Tensor:
        """Mean error [M] of trajectories of single balls, in pixels; unknown places are free."""
        horizon = self.training.horizon
        with full_precision(state.p.device):
            steps = self.network.rolling.trajectory(state, horizon)
        centres = torch.stack([step.centre for step in steps], dim=2)
        truth = balls.centres[:, :, FIRST_FORECAST_FRAME : FIRST_FORECAST_FRAME + horizon]
        off = PIXEL_UNIT * known_difference(centres, truth)
        weights = step_weights(horizon, self.training.halving).to(off.device)
        return (weights * smooth_distance(off, ROUNDING)).mean(dim=(1, 2))


def _alone(batch: BallBatch, rows: "_Rows") -> Tensor:
    """[M] 1 for balls with a known future in windows where no other ball has one, otherwise 0."""
    known = ~batch.centres[..., :2].isnan().flatten(2).any(dim=2)
    single = (known.sum(dim=1) == 1)[rows.window]
    return (single & known[rows.window, rows.ball]).float()


@dataclass(frozen=True)
class _Rows:
    """Which balls are looked at closer: [M] each."""

    window: Tensor
    ball: Tensor


def _rows(batch: BallBatch, refined_per_window: float, generator: torch.Generator) -> _Rows:
    """Draw balls, their mean number given: of different windows first, moving ones more often."""
    seen = batch.there * (batch.visible[:, :, -1].nan_to_num() > VISIBLE)
    drawn = torch.rand(seen.shape, generator=generator) + 0.7 * batch.moving.nan_to_num()
    drawn = torch.where(seen > 0, drawn, -1.0)
    best = drawn.argmax(dim=1)
    first = torch.arange(len(seen))
    kept = (seen[first, best] > 0) & (
        torch.rand(len(seen), generator=generator) < refined_per_window
    )
    window, ball = first[kept], best[kept]
    drawn[window, ball] = -1.0
    more = max(int(refined_per_window * len(seen)) - len(window), 0)
    values, flat = drawn.flatten().topk(min(more, drawn.numel()))
    flat = flat[values > 0]
    window = torch.cat([window, flat // seen.shape[1]])
    return _Rows(window, torch.cat([ball, flat % seen.shape[1]]))


def _beginnings(
    batch: BallBatch, maps: BallMaps, rows: _Rows, generator: torch.Generator
) -> tuple[BallBatch, Tensor, Tensor]:
    """Truth of the balls that are looked at [M, 1, ...], and where their first patches lie.

    There, as when it counts, the detector says where to look; prompts say it less exactly, and
    full-size frames show more of a ball than the detector saw, so places and radii are jittered.
    Some patches lie where there is no ball.
    """
    whole = BallBatch(*(field[rows.window] for field in batch))
    balls = chosen(whole, rows.ball[:, None])
    count = len(rows.window)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator)

    def within(reach: Tensor, frames: int) -> Tensor:
        """Points of discs [M, 1, frames, 2]."""
        angle = 2 * torch.pi * uniform(count, 1, frames)
        away = reach[..., None] * uniform(count, 1, frames).sqrt()
        return away[..., None] * torch.stack([angle.cos(), angle.sin()], dim=-1)

    radii = balls.radii
    clicked = (
        balls.places[:, :, -1]
        + within(torch.maximum(0.5 * radii, 1.5 * PIXEL * radii**0), 1)[:, :, 0]
    )
    with torch.no_grad():
        said = voted(BallMaps(*(part[rows.window].detach() for part in maps)), clicked)
        off = (said.places - balls.places).norm(dim=-1).amax(dim=-1)
        widths = half_widths(radii)
        lost = off > 0.8 * widths
        # Half as the second pass has them, nearly centred.
        reach = torch.where(uniform(count, 1) < 0.3, 0.35, 0.06) * widths
        # All patches of a ball lie off the same way, too: a network that seldom saw that took every
        # patch to be nearly centred, and left a third of a common offset.
        apart = torch.where(uniform(count, 1) < 0.5, 0.4, 0.06) * widths
        made = balls.places + within(reach, OBSERVED_FRAMES) + within(apart, 1)
        instead = lost | (uniform(count, 1) < 0.65)
        places = torch.where(instead[..., None, None], made, said.places)
        size = torch.where(instead, radii, said.radii.clamp(0.4 * radii, 2.5 * radii))
        spread = torch.where(reach > 0.2 * widths, 0.25, 0.08)
        size = size * torch.exp(spread * torch.randn(size.shape, generator=generator))
        nowhere = _nowhere(batch, maps, rows, generator)
        empty = nowhere.isfinite().all(dim=-1) & (uniform(count) < 0.12)
        away = nowhere[:, None, None].expand_as(places)
        places = torch.where(empty[:, None, None, None], away, places)
    there = balls.there * (~empty).float()[:, None]
    visible = balls.visible * there[..., None]
    unknown = torch.where(empty[:, None, None, None], torch.nan, balls.centres)
    spins = torch.where(empty[:, None, None, None], torch.nan, balls.spins)
    balls = balls._replace(there=there, visible=visible, centres=unknown, spins=spins)
    return balls, places, size


def _nowhere(batch: BallBatch, maps: BallMaps, rows: _Rows, generator: torch.Generator) -> Tensor:
    """Points [M, 2] that lie on no ball, where the detector sees one rather than elsewhere."""
    candidates = peaks(BallMaps(*(part.detach() for part in maps)))
    points = candidates.places[:, :, -1]
    drawn = 2 * torch.rand(points.shape, generator=generator) - 1
    points = torch.where(torch.rand(points.shape[:2], generator=generator)[..., None] < 0.5, points,
                         drawn)  # fmt: skip
    apart = (points[:, :, None] - batch.places[:, None, :, -1]).norm(dim=-1)
    clear = torch.where(
        batch.there[:, None] > 0, apart > 1.5 * batch.radii[:, None] + 3 * PIXEL, True
    ).all(dim=-1)
    first = clear.float().argmax(dim=1)
    found = points[torch.arange(len(points)), first]
    found = torch.where(clear.any(dim=1)[:, None], found, torch.nan)
    return found[rows.window]
