"""Trains a baseline: resumable at any moment, best weights by validation."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

import torch
from torch import nn
from tqdm import tqdm

from training.baselines.learner import Given, Learner
from training.data.feature_cache import save_whole
from training.objectives.schedules import Schedule

CHECKPOINT = "checkpoint.pt"
BEST = "best.pt"
CHECKPOINT_SECONDS = 120
VALIDATIONS = 20
"""Over the whole budget."""


@dataclass(frozen=True)
class FitConfig(Generic[Given]):
    """How a baseline is trained.

    Attributes
    ----------
    batches
        Budget.
    stream
        Makes the batches from a number on; batch k is always the same.
    optimiser
        Made of the parameters; its rate is the first one.
    """

    batches: int
    stream: Callable[[int], Iterator[Given]]
    optimiser: Callable[[Iterable[nn.Parameter]], torch.optim.Optimizer]
    schedule: Callable[[], Schedule]
    batch_size: int
    seed: int = 1


def fit(
    build: Callable[[], Learner[Given]],
    fit_config: FitConfig[Given],
    folder: Path,
    validate: Callable[[Learner[Given]], float],
) -> Learner[Given]:
    """Train a baseline from its last checkpoint on; return it with its best weights.

    Parameters
    ----------
    folder
        Where checkpoint and best weights are kept.
    validate
        Error of a learner that decides which weights are the best.
    """
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(fit_config.seed)
    learner = build()
    optimiser = fit_config.optimiser(learner.parameters())
    first_rates = [group["lr"] for group in optimiser.param_groups]
    schedule = fit_config.schedule()
    done, best = 0, math.inf
    checkpoint = folder / CHECKPOINT
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        learner.load_state_dict(state["weights"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.restore(state["schedule"])
        done, best = state["batches"], state["best"]
    saved = time.monotonic()
    every = max(1, fit_config.batches // VALIDATIONS)
    batches = fit_config.stream(done)
    progress = tqdm(total=fit_config.batches, initial=done, unit="batch", desc=folder.name)
    while done < fit_config.batches:
        spent = done / fit_config.batches
        for group, rate in zip(optimiser.param_groups, first_rates, strict=True):
            group["lr"] = rate * schedule.factor(spent)
        learner.train()
        loss = learner.loss(next(batches), spent)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        schedule.observe(float(loss.detach()), fit_config.batch_size)
        done += 1
        progress.update()
        if done % every == 0 or done == fit_config.batches:
            learner.eval()
            with torch.inference_mode():
                error = validate(learner)
            progress.set_postfix(error=f"{error:.2f} px")
            if error < best:
                best = error
                save_whole(folder / BEST, {"weights": learner.state_dict(), "error_px": error})
        if time.monotonic() - saved > CHECKPOINT_SECONDS or done == fit_config.batches:
            save_whole(
                checkpoint,
                {
                    "weights": learner.state_dict(),
                    "optimiser": optimiser.state_dict(),
                    "schedule": schedule.state(),
                    "batches": done,
                    "best": best,
                },
            )
            saved = time.monotonic()
    progress.close()
    learner.load_state_dict(torch.load(folder / BEST, weights_only=True)["weights"])
    return learner.eval()
