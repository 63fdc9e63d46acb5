"""The training loop: resumable at any moment, weights averaged, the best kept by validation.

:class:`training.engine.trainer.Trainer` trains recipes with it, :mod:`training.baselines.fitting`
the paper's other systems.
"""

import math
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Generic, TypeVar

import torch
from torch import nn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from training.common import distributed
from training.common.run_folder import BEST, CHECKPOINT, EVENTS, LOSS, read_whole, save_whole
from training.objectives.schedules import Schedule

Item = TypeVar("Item")
"""A batch."""

USUAL_GRADIENT_MEMORY = 0.99
CONVERGED_GAIN = 0.02
"""Share by which the validation error of a converged training fell over its last fifth, at most."""


class TrainingStoppedError(Exception):
    """Ctrl-C ended a training, which left a checkpoint to go on from."""


@dataclass(frozen=True)
class TrainerConfig:
    """How often things happen, in batches, and how many processes serve the training."""

    validate_every: int = 500
    checkpoint_seconds: float = 120
    workers: int = 1
    """Processes that render training batches."""
    simulators: int = 1
    """Processes that simulate missing scenes."""
    device: str = "auto"
    """Device of torch that trains a recipe; "auto" is a GPU if there is one, otherwise the CPU."""


@dataclass(frozen=True)
class Optimisation:
    """How weights are trained.

    Attributes
    ----------
    batches
        Budget in optimiser steps.
    gradient_clip
        Longest gradient, in multiples of the usual length.
    average_decay
        Decay of the exponential moving average of the weights, which is evaluated; with 0 the
        weights themselves are.
    """

    batches: int
    batch_size: int
    optimiser: Callable[[Any], torch.optim.Optimizer]
    schedule: Callable[[], Schedule]
    gradient_clip: float = math.inf
    average_decay: float = 0.0


class TrainingLoop(ABC, Generic[Item]):
    """One training run in a folder of its own.

    Parameters
    ----------
    module
        Trained module.
    groups
        Its parameters, or groups of them as the optimiser takes them.
    folder
        Where checkpoints, the best weights and TensorBoard events go.
    """

    def __init__(
        self,
        module: nn.Module,
        groups: Iterable[nn.Parameter] | Iterable[dict[str, Any]],
        optimisation: Optimisation,
        folder: Path,
        config: TrainerConfig,
    ) -> None:
        self.module = module
        self.folder = folder
        self.optimisation = optimisation
        self._config = config
        self._average = torch.optim.swa_utils.AveragedModel(
            module, multi_avg_fn=warmed_average(optimisation.average_decay)
        )
        self._optimiser = optimisation.optimiser(groups)
        self._first_rates = [group["lr"] for group in self._optimiser.param_groups]
        self._schedule = optimisation.schedule()
        self.batches = 0
        self.best_error = math.inf
        self.validations: list[tuple[int, float]] = []
        """Batches and validation error, in px, of every validation."""
        self._usual_gradient = 0.0
        self._checkpoint_time = time.monotonic()

    @abstractmethod
    def _stream(self) -> Iterator[Item]:
        """Return the batches from the next one on; batch k is always the same."""

    @abstractmethod
    def _loss(self, batch: Item, progress: float) -> torch.Tensor:
        """Return the loss of a batch after the fraction ``progress`` of the budget."""

    @abstractmethod
    def _errors(self) -> tuple[float, Mapping[str, float]]:
        """Return the validation error of the averaged weights in px, and errors to plot."""

    @abstractmethod
    def _best_weights(self) -> dict[str, Any]:
        """Return the checkpoint of the averaged weights, kept if their error is the best."""

    def _set_rates(self, progress: float) -> None:
        """Set the learning rates of a batch."""
        factor = self._schedule.factor(progress)
        for group, rate in zip(self._optimiser.param_groups, self._first_rates, strict=True):
            group["lr"] = rate * factor

    def stream(self) -> Iterator[Item]:
        """Return the batches from the next one on."""
        return distributed.main_process_first(self._stream)

    def step(self, batch: Item) -> float:
        """Take an optimiser step; return the loss."""
        return self._step(batch, self.progress)

    @property
    def sequences(self) -> int:
        """Training sequences seen so far."""
        return self.batches * self.optimisation.batch_size

    @property
    def progress(self) -> float:
        """Share of the budget that is gone."""
        return self.batches / self.optimisation.batches

    @property
    def _ended(self) -> bool:
        return self.batches >= self.optimisation.batches or self._schedule.finished

    def run(self) -> float:
        """Train until the budget is spent, from the last checkpoint on.

        Returns
        -------
        float
            The best validation error, in pixels; infinite in processes that only help.

        Raises
        ------
        TrainingStoppedError
            After Ctrl-C, once a checkpoint is written.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        self._resume()
        stream = iter(self.stream())
        if not distributed.is_main_process():
            while not self._ended:
                self.step(next(stream))
            return math.inf
        total = self.optimisation.batches
        try:
            with interrupted_between_steps() as step:
                self._train(stream, step)
        except KeyboardInterrupt:
            self._save_checkpoint()
            raise TrainingStoppedError(
                f"stopped after {self.batches:,} of {total:,} batches; the checkpoint is in "
                f"{self.folder}, and the same command goes on from there"
            ) from None
        self._save_checkpoint()
        return self.best_error

    def _train(self, stream: Iterator[Item], step: Callable[[], Any]) -> None:
        """Take steps, validate and save until the training has ended."""
        events = SummaryWriter(str(self.folder / EVENTS), purge_step=self.sequences)
        total = self.optimisation.batches
        bar = tqdm(total=total, initial=self.batches, unit="batch", desc=self.folder.name)
        with closing(events), closing(bar):
            while True:
                self._validate_if_due(events)
                if self._ended:
                    return
                with step():
                    loss = self.step(next(stream))
                bar.update()
                if self.batches % 20 == 0:
                    bar.set_postfix(loss=f"{loss:.3g}", best=f"{self.best_error:.2f} px")
                    events.add_scalar(LOSS, loss, self.sequences)
                if time.monotonic() - self._checkpoint_time > self._config.checkpoint_seconds:
                    self._save_checkpoint()

    def _step(self, batch: Item, progress: float) -> float:
        self.module.train()
        self._set_rates(progress)
        loss = self._loss(batch, progress)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        distributed.average_gradients(self.module.parameters())
        self._clip_gradients()
        self._optimiser.step()
        self.batches += 1
        if self.optimisation.average_decay > 0:
            self._average.update_parameters(self.module)
        value = distributed.average_value(float(loss.detach()))
        self._schedule.observe(value, self.optimisation.batch_size)
        return value

    def _clip_gradients(self) -> None:
        """Cut the gradient to a multiple of its usual length, a running geometric mean.

        Lengths are heavy-tailed over long rollouts: rare ones rule any other mean.
        """
        usual = self._usual_gradient
        limit = self.optimisation.gradient_clip * usual if usual else math.inf
        norm = float(torch.nn.utils.clip_grad_norm_(self.module.parameters(), limit))
        if not math.isfinite(norm):
            # Without gradients the optimiser leaves everything as it is.
            self._optimiser.zero_grad(set_to_none=True)
            return
        memory = min(USUAL_GRADIENT_MEMORY, self.batches / (self.batches + 1))
        self._usual_gradient = usual**memory * norm ** (1 - memory)

    def _validate_if_due(self, events: SummaryWriter) -> None:
        """Measure the averaged weights and keep them when their error is the best."""
        last = self.validations[-1][0] if self.validations else 0
        due = self.batches % self._config.validate_every == 0 or self._ended
        if not due or self.batches == last:
            return
        if self.optimisation.average_decay == 0:
            self._average.update_parameters(self.module)
        self._average.eval()
        error, scalars = self._errors()
        for tag, value in scalars.items():
            events.add_scalar(tag, value, self.sequences)
        # Of equals the later: where positions stay as they are, covariances go on learning.
        if error <= self.best_error:
            self.best_error = error
            save_whole(self.folder / BEST, self._best_weights())
        self.validations.append((self.batches, error))

    def averaged(self) -> nn.Module:
        """Return the trained module with the averaged weights."""
        return self._average.module

    @property
    def converged(self) -> bool | None:
        """Whether the validation error hardly fell over the last fifth of the training."""
        return converged(self.validations)

    def _save_checkpoint(self) -> None:
        save_whole(
            self.folder / CHECKPOINT,
            {
                "module": self.module.state_dict(),
                "average": self._average.state_dict(),
                "optimiser": self._optimiser.state_dict(),
                "schedule": self._schedule.state(),
                "batches": self.batches,
                "usual_gradient": self._usual_gradient,
                "best_error": self.best_error,
                "validations": self.validations,
                "random": torch.get_rng_state(),
            },
        )
        self._checkpoint_time = time.monotonic()

    def _resume(self) -> None:
        """Go on from the last checkpoint, if there is one."""
        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        device = next(self.module.parameters()).device
        state = read_whole(path, device)
        self.module.load_state_dict(state["module"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._schedule.restore(state["schedule"])
        self.batches = state["batches"]
        self._usual_gradient = state["usual_gradient"]
        self.best_error = state["best_error"]
        self.validations = [(int(batches), float(error)) for batches, error in state["validations"]]
        torch.set_rng_state(state["random"].cpu())


def converged(validations: Sequence[tuple[int, float]]) -> bool | None:
    """Whether the best validation error fell by less than 2 % over the last fifth of a training.

    Parameters
    ----------
    validations
        Batches and error of every validation, in order.

    Returns
    -------
    bool or None
        None when no validation lies before the last fifth.
    """
    if not validations:
        return None
    begin = 0.8 * validations[-1][0]
    before = [error for batches, error in validations if batches <= begin]
    if not before:
        return None
    best = min(error for _, error in validations)
    return min(before) - best < CONVERGED_GAIN * min(before)


@contextmanager
def interrupted_between_steps() -> Iterator[Callable[[], Any]]:
    """Hold Ctrl-C back while a step changes weights; give the context that a step runs in.

    A second Ctrl-C takes effect at once.
    """
    held, stepping = [False], [False]

    def interrupted(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - a handler's
        if not stepping[0] or held[0]:
            raise KeyboardInterrupt
        held[0] = True

    @contextmanager
    def step() -> Iterator[None]:
        stepping[0] = True
        try:
            yield
        finally:
            stepping[0] = False
        if held[0]:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield step
        return
    usual = signal.signal(signal.SIGINT, interrupted)
    try:
        yield step
    finally:
        signal.signal(signal.SIGINT, usual)


def warmed_average(decay: float) -> Callable[..., None]:
    """Exponential moving average that follows closely at first; else it lags for long.

    Parameters
    ----------
    decay
        Asymptotic decay; that of update n is at most (1 + n) / (10 + n).
    """

    def update(
        averaged: list[torch.Tensor], current: list[torch.Tensor], updates: torch.Tensor
    ) -> None:
        now = min(decay, (1 + int(updates)) / (10 + int(updates)))
        torch.optim.swa_utils.get_ema_multi_avg_fn(now)(averaged, current, updates)

    return update
