"""Trains a baseline in the loop that recipes are trained in."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple

import torch
from torch import Tensor, nn

from training.baselines.learner import Given, Learner
from training.common.precision import mixed_precision
from training.common.run_folder import read_best
from training.engine.loop import Optimisation, TrainerConfig, TrainingLoop
from training.objectives.schedules import Schedule

VALIDATIONS = 20
"""Number of validations over the whole budget."""


@dataclass(frozen=True)
class FitConfig(Generic[Given]):
    """How a baseline is trained.

    Attributes
    ----------
    batches
        Budget in optimiser steps.
    stream
        Makes the batches from a number on; batch k is always the same.
    optimiser
        Made of the parameters; its rate is the first one.
    bfloat16
        Whether it computes in bfloat16 where the processor is made for that.
    """

    batches: int
    stream: Callable[[int], Iterator[Given]]
    optimiser: Callable[[Iterable[nn.Parameter]], torch.optim.Optimizer]
    schedule: Callable[[], Schedule]
    batch_size: int
    seed: int = 1
    bfloat16: bool = False


class Fitted(NamedTuple, Generic[Given]):
    """A trained baseline with its best weights, and whether its training had converged."""

    learner: Learner[Given]
    converged: bool | None


class LearnerTrainer(TrainingLoop[Given]):
    """The training of a baseline in a folder of its own."""

    def __init__(
        self,
        learner: Learner[Given],
        fit_config: FitConfig[Given],
        folder: Path,
        validate: Callable[[Learner[Given]], float],
        config: TrainerConfig,
    ) -> None:
        optimisation = Optimisation(
            fit_config.batches, fit_config.batch_size, fit_config.optimiser, fit_config.schedule
        )
        super().__init__(learner, learner.parameters(), optimisation, folder, config)
        self._learner = learner
        self._fit_config = fit_config
        self._validate = validate

    def _stream(self) -> Iterator[Given]:
        return self._fit_config.stream(self.batches)

    def _loss(self, batch: Given, progress: float) -> Tensor:
        if not self._fit_config.bfloat16:
            return self._learner.loss(batch, progress)
        with mixed_precision(torch.device("cpu")):
            return self._learner.loss(batch, progress)

    def _errors(self) -> tuple[float, Mapping[str, float]]:
        averaged = self.averaged()
        assert isinstance(averaged, Learner)
        with torch.inference_mode():
            error = self._validate(averaged)
        return error, {"validation/error": error}

    def _best_weights(self) -> dict[str, Any]:
        return {"weights": self.averaged().state_dict(), "error_px": self.best_error}


def fit(
    build: Callable[[], Learner[Given]],
    fit_config: FitConfig[Given],
    folder: Path,
    validate: Callable[[Learner[Given]], float],
    checkpoint_seconds: float = TrainerConfig.checkpoint_seconds,
) -> Fitted[Given]:
    """Train a baseline from its last checkpoint on; return it with its best weights.

    Parameters
    ----------
    folder
        Where checkpoint and best weights are kept.
    validate
        Error of a learner that decides which weights are the best.
    """
    torch.manual_seed(fit_config.seed)
    learner = build()
    every = max(1, fit_config.batches // VALIDATIONS)
    config = TrainerConfig(validate_every=every, checkpoint_seconds=checkpoint_seconds)
    trainer = LearnerTrainer(learner, fit_config, folder, validate, config)
    trainer.run()
    learner.load_state_dict(read_best(folder)["weights"])
    return Fitted(learner.eval(), trainer.converged)
