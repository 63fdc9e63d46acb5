"""Trains a recipe: resumable at any moment, unattended, on a GPU when there is one."""

import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader

from training.common import distributed
from training.common.devices import chosen_device
from training.data.appearance_mixture import other_appearances
from training.data.clip_dataset import Clips, ClipStream
from training.data.feature_cache import read_windows, replayed
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, load_recordings, simulate_split
from training.data.splits import Split
from training.data.windows import Batch, TrainingStream, Window, compared_horizon, fixed_windows
from training.engine.loop import Optimisation, TrainerConfig, TrainingLoop
from training.engine.total_loss import Objective
from training.engine.warm_start import Initial, load_fitting
from training.networks.fieldnet import FieldNet
from training.networks.recurrent import Family, PerceptionFamily
from training.objectives.metrics import forecast
from training.recipes.recipe import Recipe, longest_rollout

FEATURE_CACHE = "feature_cache.pt"
READ_TOGETHER = 32
"""Windows that are read at once to be replayed."""
VALIDATION_STRIDE = 5
"""Frames between the validation windows of a clip."""
SHARED_WARM_UP = 0.02
"""Share of the budget over which the shared parameters' rate rises after the heads' time alone."""


class Trainer(TrainingLoop[Batch]):
    """The training of a recipe in a folder of its own.

    Parameters
    ----------
    folder
        Where checkpoints, the best weights and TensorBoard events go.
    initial
        Initial networks: each by its name, or all of them if no name matches. Shared parts come
        from the first one; parameters that none has stay untrained.
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
        self._clips = clips
        self.device = chosen_device((config or TrainerConfig()).device)
        self.family = recipe.build()
        for trained in reversed(initial):
            members = self.family.networks()
            for name in [trained.name] if trained.name in members else members:
                load_fitting(members[name], trained.parameters)
        self._earlier_sequences = initial[0].sequences if initial else 0
        for network in self.family.networks().values():
            for name, parameter in network.named_parameters():
                parameter.requires_grad_(not name.startswith(recipe.frozen))
        # torch's own annotations leave memory_format out.
        self.family.to(self.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        optimisation = Optimisation(
            recipe.sequences // recipe.batch_size,
            recipe.batch_size,
            lambda groups: recipe.optimiser(groups, recipe.learning_rate),
            recipe.schedule,
            recipe.gradient_clip,
            recipe.average_decay,
        )
        super().__init__(
            self.family, self._groups(), optimisation, folder, config or TrainerConfig()
        )
        self._objective = Objective(recipe, self.family, self.device)

    def _groups(self) -> list[dict[str, list[torch.nn.Parameter]]]:
        """Return the groups of parameters by learning rate: shared, explicit motion, the rest."""
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
    def _windows_seen(self) -> int:
        """Number of distinct training windows so far; replayed ones count once."""
        replayed_windows = self.recipe.replay_windows
        return min(self.sequences, replayed_windows) if replayed_windows else self.sequences

    def _stream(self) -> Iterator[Batch]:
        """Return the batches from the next one on: rendered, or drawn from cached features."""
        recipe = self.recipe
        windows = recipe.explicit.true_state_windows if recipe.explicit else 0
        if not recipe.replay_windows:
            return self._fresh(recipe.batch_size, self.batches, true_state_windows=windows)
        path = self.folder / FEATURE_CACHE
        if not path.exists():
            assert isinstance(self.family, PerceptionFamily)
            whole = self._fresh(READ_TOGETHER, 0, share=distributed.Share())
            read_windows(self.family, whole, recipe.replay_windows, path)
        batches = replayed(path, recipe.batch_size, recipe.seed, self.batches, distributed.share())
        if not windows:
            return batches
        unseen = self._fresh(windows, self.batches, seen=False)
        return (
            {**batch, "from_true_states": other}
            for batch, other in zip(batches, unseen, strict=True)
        )

    def _fresh(
        self,
        batch_size: int,
        first_batch: int,
        *,
        true_state_windows: int = 0,
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
                true_state_windows=true_state_windows,
                seen=seen,
                scene_targets=recipe.explicit is not None,
                share=share or distributed.share(),
                mixture=recipe.appearances,
            )
        loader = DataLoader(
            stream,
            batch_size=None,
            num_workers=self._config.workers,
            prefetch_factor=4 if self._config.workers else None,
            worker_init_fn=_give_way,
        )
        return iter(loader)

    def _set_rates(self, progress: float) -> None:
        recipe = self.recipe
        shared, motion, rest = self._optimiser.param_groups
        rate = recipe.learning_rate * self._schedule.factor(progress)
        rest["lr"] = rate
        motion["lr"] = rate * (recipe.explicit.motion_rate if recipe.explicit else 1.0)
        shared["lr"] = rate * shared_factor(progress, recipe.heads_alone)
        for parameter in shared["params"]:
            parameter.requires_grad_(progress >= recipe.heads_alone)

    def _loss(self, batch: Batch, progress: float) -> torch.Tensor:
        return self._objective.loss(batch, progress)

    @cached_property
    def _validation_windows(self) -> dict[str, list[Window]]:
        """Windows of the validation split by scenario or clip."""
        if self._clips is None:
            return validation_windows(self.recipe, self._config.simulators)
        clips, horizon = self._clips["validation"], self.recipe.trained_horizon
        places = clips.places(horizon, every=VALIDATION_STRIDE)
        return {"footage": [clips.window(place, horizon) for place in places]}

    def _errors(self) -> tuple[float, Mapping[str, float]]:
        horizon = self.recipe.trained_horizon
        compared = min(compared_horizon(self.recipe.task.objects), horizon)
        averaged = self.averaged()
        errors: list[float] = []
        scalars: dict[str, float] = {}
        for source, windows in self._validation_windows.items():
            for name, forecasts in forecast(averaged, windows, horizon, self.device).items():
                by_step = forecasts.errors_px().mean(axis=(0, 1))
                # Of planar scenes only the seen places are known.
                known = by_step[np.isfinite(by_step)]
                errors.append(float(known[min(compared, len(known)) - 1]))
                for step in sorted({1, horizon // 2, horizon} & set(range(1, len(known) + 1))):
                    scalars[f"{name}/{source}/T={step}"] = by_step[step - 1]
        error = sum(errors) / len(errors)
        return error, scalars | {f"validation/T={compared}": error}

    def averaged(self) -> Family:
        """Return the networks with the averaged weights."""
        module = super().averaged()
        assert isinstance(module, Family)
        return module

    def _best_weights(self) -> dict[str, Any]:
        return {
            "weights": {
                name: member.state_dict() for name, member in self.averaged().networks().items()
            },
            "sequences": self._earlier_sequences + self._windows_seen,
            "horizon": longest_rollout(self.recipe, self.progress),
            "validation_error_px": self.best_error,
        }


def _give_way(worker: int) -> None:  # noqa: ARG001 - the loader passes its number
    """Let rendering fill gaps only: a network's threads wait for the one that lost its core."""
    os.nice(10)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends it, once a checkpoint is written


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
    return (
        windows if recipe.appearances is None else windows | other_appearances(recordings, horizon)
    )


def shared_factor(progress: float, heads_alone: float) -> float:
    """Factor on the shared parameters' rate: it rises once the heads have learned alone."""
    return min(max((progress - heads_alone) / SHARED_WARM_UP, 0.0), 1.0) if heads_alone else 1.0
