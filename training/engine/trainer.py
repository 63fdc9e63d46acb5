"""Trains a recipe: resumable at any moment, unattended, on a GPU when there is one."""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from training.common import distributed
from training.data.clip_dataset import Clips, ClipStream
from training.data.feature_cache import read_windows, rehearsed, save_whole
from training.data.looks import other_looks
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, load_recordings, simulate_split
from training.data.splits import Split
from training.data.windows import Batch, TrainingStream, Window, compared_horizon, fixed_windows
from training.engine.total_loss import Objective
from training.engine.warm_start import Initial, load_fitting
from training.networks.fieldnet import FieldNet
from training.networks.recurrent import EyedFamily, Family
from training.objectives.metrics import forecast
from training.recipes.recipe import Recipe, longest_rollout

CHECKPOINT = "checkpoint.pt"
BEST = "best.pt"
READINGS = "readings.pt"
EVENTS = "events"
LOSS = "training/loss"
"""Tag of the events; all others tell errors in px."""
READ_TOGETHER = 32
"""Windows that are read at once to be rehearsed."""
VALIDATION_STRIDE = 5
"""Frames between the validation windows of a clip."""
USUAL_GRADIENT_MEMORY = 0.99
SHARED_WARM_UP = 0.02
"""Share of the budget over which the shared parameters' rate rises after the heads' time alone."""


@dataclass(frozen=True)
class TrainerConfig:
    """How often things happen, in batches, and how many processes serve the training."""

    validate_every: int = 500
    checkpoint_seconds: float = 120
    workers: int = 1
    """Processes that render training batches."""
    simulators: int = 1
    """Processes that simulate missing scenes."""


class Trainer:
    """One training run in a folder of its own.

    Parameters
    ----------
    folder
        Where checkpoints, the best weights and TensorBoard events go.
    initial
        What to start from: each network by its name, all of them where no name fits. What the
        networks share comes from the first; parameters that none has stay untrained.
    clips
        Footage to train on and validate with; None for simulated scenes.
    """

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        config: TrainerConfig | None = None,
        initial: Sequence[Initial] = (),
        clips: Mapping[Split, Clips] | None = None,
    ) -> None:
        torch.manual_seed(recipe.seed)
        self.recipe = recipe
        self.folder = folder
        self._config = config or TrainerConfig()
        self._clips = clips
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.family = recipe.build()
        for trained in reversed(initial):
            members = self.family.networks()
            for name in [trained.name] if trained.name in members else members:
                load_fitting(members[name], trained.parameters)
        self._earlier_sequences = initial[0].sequences if initial else 0
        for network in self.family.networks().values():
            for name, parameter in network.named_parameters():
                parameter.requires_grad_(not name.startswith(recipe.taught))
        # torch's own annotations leave memory_format out.
        self.family.to(self.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self._average = torch.optim.swa_utils.AveragedModel(
            self.family,
            multi_avg_fn=warmed_average(recipe.average_decay),
        )
        self._optimiser = recipe.optimiser(self._groups(), recipe.learning_rate)
        self._schedule = recipe.schedule()
        self._objective = Objective(recipe, self.family, self.device)
        self.batches = 0
        self._usual_gradient = 0.0
        self._best_error = math.inf
        self._checkpoint_time = time.monotonic()

    def _groups(self) -> list[dict[str, list[torch.nn.Parameter]]]:
        """Return what learns at a rate of its own: shared parts, explicit motion, and the rest."""
        shared = self.family.shared_parameters()
        motion = [
            parameter
            for network in self.family.networks().values()
            if isinstance(network, FieldNet)
            for parameter in network.rolling.parameters()
        ]
        known = {id(parameter) for parameter in [*shared, *motion]}
        rest = [p for p in self.family.parameters() if id(p) not in known]
        return [
            {"params": [parameter for parameter in group if parameter.requires_grad]}
            for group in (shared, motion, rest)
        ]

    @property
    def sequences(self) -> int:
        """Training sequences seen so far."""
        return self.batches * self.recipe.batch_size

    @property
    def _windows_seen(self) -> int:
        """Training windows seen so far; those that are rehearsed count once."""
        rehearsal = self.recipe.rehearsal
        return min(self.sequences, rehearsal) if rehearsal else self.sequences

    @property
    def _batches_in_all(self) -> int:
        return self.recipe.sequences // self.recipe.batch_size

    def run(self) -> float:
        """Train until the budget is spent, from the last checkpoint on.

        Returns
        -------
        float
            The best validation error, in pixels; infinite for those who only help (``crew``).
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        self._resume()
        recipe = self.recipe
        stream = iter(distributed.main_process_first(self._stream))
        total = self._batches_in_all
        if not distributed.is_main_process():
            while self.batches < total and not self._schedule.finished:
                self._step(next(stream), self.batches / total)
            return math.inf
        windows = self._validation_windows()
        events = SummaryWriter(str(self.folder / EVENTS), purge_step=self.sequences)
        progress = tqdm(total=total, initial=self.batches, unit="batch", desc=recipe.name)
        while self.batches < total and not self._schedule.finished:
            loss = self._step(next(stream), self.batches / total)
            progress.update()
            if self.batches % 20 == 0:
                progress.set_postfix(loss=f"{loss:.2f}", best=f"{self._best_error:.2f} px")
                events.add_scalar(LOSS, loss, self.sequences)
            ended = self.batches == total or self._schedule.finished
            if self.batches % self._config.validate_every == 0 or ended:
                self._validate(windows, events)
            if time.monotonic() - self._checkpoint_time > self._config.checkpoint_seconds:
                self._save_checkpoint()
        self._save_checkpoint()
        events.close()
        return self._best_error

    def _stream(self) -> Iterator[Batch]:
        """Return the batches from the next one on: seen anew, or drawn from readings."""
        recipe = self.recipe
        practice = recipe.explicit.practice if recipe.explicit else 0
        if not recipe.rehearsal:
            return self._fresh(recipe.batch_size, self.batches, practice=practice)
        path = self.folder / READINGS
        if not path.exists():
            assert isinstance(self.family, EyedFamily)
            whole = self._fresh(READ_TOGETHER, 0, share=distributed.Share())
            read_windows(self.family, whole, recipe.rehearsal, path)
        batches = rehearsed(path, recipe.batch_size, recipe.seed, self.batches, distributed.share())
        if not practice:
            return batches
        unseen = self._fresh(practice, self.batches, seen=False)
        return ({**batch, "practice": other} for batch, other in zip(batches, unseen, strict=True))

    def _fresh(
        self,
        batch_size: int,
        first_batch: int,
        *,
        practice: int = 0,
        seen: bool = True,
        share: distributed.Share | None = None,
    ) -> Iterator[Batch]:
        """Return batches of windows, cut anew, by default this process's share of them.

        See :class:`TrainingStream`.
        """
        recipe, simulators = self.recipe, self._config.simulators
        if self._clips is not None:
            stream = ClipStream(
                self._clips["training"],
                recipe.trained_horizon,
                batch_size,
                recipe.seed,
                first_batch,
                scene_targets=recipe.explicit is not None,
                share=share or distributed.share(),
            )
        else:
            shards = [
                simulate_split(part.source, "training", part.scenes, simulators)
                for part in recipe.data
            ]
            stream = TrainingStream(
                [load_recordings(of_source) for of_source in shards],
                [part.share for part in recipe.data],
                [part.latest_start for part in recipe.data],
                recipe.task.final_step,
                batch_size,
                recipe.seed,
                first_batch=first_batch,
                scene_caches=[load_scene_cache(of_source, simulators) for of_source in shards],
                practice=practice,
                seen=seen,
                scene_targets=recipe.explicit is not None,
                share=share or distributed.share(),
                mixture=recipe.looks,
            )
        loader = DataLoader(
            stream,
            batch_size=None,
            num_workers=self._config.workers,
            prefetch_factor=4 if self._config.workers else None,
            worker_init_fn=_give_way,
        )
        return iter(loader)

    def _step(self, batch: Batch, progress: float) -> float:
        recipe = self.recipe
        self.family.train()
        shared, motion, rest = self._optimiser.param_groups
        rate = recipe.learning_rate * self._schedule.factor(progress)
        rest["lr"] = rate
        motion["lr"] = rate * (recipe.explicit.motion_rate if recipe.explicit else 1.0)
        shared["lr"] = rate * shared_factor(progress, recipe.heads_alone)
        for parameter in shared["params"]:
            parameter.requires_grad_(progress >= recipe.heads_alone)
        loss = self._objective.loss(batch, progress)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        distributed.average_gradients(self.family.parameters())
        self._clip_gradients()
        self._optimiser.step()
        self.batches += 1
        self._average.update_parameters(self.family)
        value = distributed.average_value(float(loss.detach()))
        self._schedule.observe(value, recipe.batch_size)
        return value

    def _clip_gradients(self) -> None:
        """Cut the gradient to a multiple of its usual length, a running geometric mean.

        Lengths are heavy-tailed over long rollouts: rare ones rule any other mean.
        """
        usual = self._usual_gradient
        limit = self.recipe.gradient_clip * usual if usual else math.inf
        norm = float(torch.nn.utils.clip_grad_norm_(self.family.parameters(), limit))
        if not math.isfinite(norm):
            # Without gradients the optimiser leaves everything as it is.
            self._optimiser.zero_grad(set_to_none=True)
            return
        memory = min(USUAL_GRADIENT_MEMORY, self.batches / (self.batches + 1))
        self._usual_gradient = usual**memory * norm ** (1 - memory)

    def _validation_windows(self) -> dict[str, list[Window]]:
        """Windows of the validation split by what they show."""
        if self._clips is None:
            return validation_windows(self.recipe, self._config.simulators)
        clips, horizon = self._clips["validation"], self.recipe.trained_horizon
        places = clips.places(horizon, every=VALIDATION_STRIDE)
        return {"footage": [clips.window(place, horizon) for place in places]}

    def _validate(self, windows: dict[str, list[Window]], events: SummaryWriter) -> None:
        """Measure the averaged weights and keep them when their mean error is the best."""
        horizon = self.recipe.trained_horizon
        compared = min(compared_horizon(self.recipe.task.objects), horizon)
        averaged = self.averaged()
        errors: list[float] = []
        for source, source_windows in windows.items():
            for name, forecasts in forecast(averaged, source_windows, horizon, self.device).items():
                by_step = forecasts.errors_px().mean(axis=(0, 1))
                # Of planar scenes only the seen places are known.
                known = by_step[np.isfinite(by_step)]
                errors.append(float(known[min(compared, len(known)) - 1]))
                for step in sorted({1, horizon // 2, horizon} & set(range(1, len(known) + 1))):
                    tag = f"{name}/{source}/T={step}"
                    events.add_scalar(tag, by_step[step - 1], self.sequences)
        error = sum(errors) / len(errors)
        events.add_scalar(f"validation/T={compared}", error, self.sequences)
        # Of equals the later: where positions stay as they are, doubt goes on learning.
        if error <= self._best_error:
            self._best_error = error
            save_whole(self.folder / BEST, self._weights())

    def averaged(self) -> Family:
        """Return the networks with the averaged weights."""
        module = self._average.module
        assert isinstance(module, Family)
        return module

    def _weights(self) -> dict[str, Any]:
        return {
            "weights": {
                name: member.state_dict() for name, member in self.averaged().networks().items()
            },
            "sequences": self._earlier_sequences + self._windows_seen,
            "horizon": longest_rollout(self.recipe, self.batches / self._batches_in_all),
            "validation_error_px": self._best_error,
        }

    def _save_checkpoint(self) -> None:
        save_whole(
            self.folder / CHECKPOINT,
            {
                "family": self.family.state_dict(),
                "average": self._average.state_dict(),
                "optimiser": self._optimiser.state_dict(),
                "schedule": self._schedule.state(),
                "batches": self.batches,
                "usual_gradient": self._usual_gradient,
                "best_error": self._best_error,
                "random": torch.get_rng_state(),
            },
        )
        self._checkpoint_time = time.monotonic()

    def _resume(self) -> None:
        """Go on from the last checkpoint, if there is one. Batch k is the same after a stop."""
        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        state = torch.load(path, map_location=self.device, weights_only=True)
        self.family.load_state_dict(state["family"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._schedule.restore(state["schedule"])
        self.batches = state["batches"]
        self._usual_gradient = state["usual_gradient"]
        self._best_error = state["best_error"]
        torch.set_rng_state(state["random"].cpu())


def _give_way(worker: int) -> None:  # noqa: ARG001 - the loader passes its number
    """Let rendering fill gaps only: a network's threads wait for the one that lost its core."""
    os.nice(10)


def validation_windows(recipe: Recipe, simulators: int) -> dict[str, list[Window]]:
    """Windows of the validation split, for every scenario at the usual radius."""
    sources = [Source(scenario, recipe.task.objects) for scenario in recipe.scenarios]
    recordings = {
        source.name: load_recordings(
            simulate_split(source, "validation", recipe.validation_scenes, simulators)
        )
        for source in sources
    }
    horizon = recipe.trained_horizon
    windows = {
        name: fixed_windows(of_source, horizon, recipe.task.final_step)
        for name, of_source in recordings.items()
    }
    return windows if recipe.looks is None else windows | other_looks(recordings, horizon)


def warmed_average(decay: float) -> Callable[..., None]:
    """Exponential moving average that follows closely at first; else it lags for long.

    Parameters
    ----------
    decay
        Of the average in the long run; that of update n is at most (1 + n) / (10 + n).
    """

    def update(
        averaged: list[torch.Tensor], current: list[torch.Tensor], updates: torch.Tensor
    ) -> None:
        now = min(decay, (1 + int(updates)) / (10 + int(updates)))
        torch.optim.swa_utils.get_ema_multi_avg_fn(now)(averaged, current, updates)

    return update


def shared_factor(progress: float, heads_alone: float) -> float:
    """Factor on the shared parameters' rate: it rises once the heads have learned alone."""
    return min(max((progress - heads_alone) / SHARED_WARM_UP, 0.0), 1.0) if heads_alone else 1.0
