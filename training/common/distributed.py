"""Processes that train one network together: each takes its share of every batch.

Batch, weights, schedule and average are the same in all of them after every step, so the networks
come out as if one process had seen the whole batches. Without a process group there is one.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import distributed

T = TypeVar("T")


@dataclass(frozen=True)
class Share:
    """Rows of every batch for one process: ``first``, ``first + every``, and so on."""

    first: int = 0
    every: int = 1

    def of(self, rows: int) -> range:
        """Return the rows of a batch.

        Raises
        ------
        ValueError
            When the shares would not be equal: the mean of their means would not be the batch's.
        """
        if rows % self.every:
            raise ValueError(
                f"{rows} windows of a batch cannot be divided among {self.every} processes"
            )
        return range(self.first, rows, self.every)


def share() -> Share:
    """Return this process's share."""
    if not distributed.is_initialized():
        return Share()
    return Share(distributed.get_rank(), distributed.get_world_size())


def is_main_process() -> bool:
    """Tell whether this process is the one that validates and writes."""
    return share().first == 0


def main_process_first(work: Callable[[], T]) -> T:
    """Run work that writes files in the main process first, then in the others."""
    if share().every == 1:
        return work()
    if not is_main_process():
        distributed.barrier()
        return work()
    done = work()
    distributed.barrier()
    return done


def average_gradients(parameters: Iterable[torch.nn.Parameter]) -> None:
    """Give all processes the mean of their gradients."""
    if share().every == 1:
        return
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    together = torch.cat([gradient.flatten() for gradient in gradients])
    distributed.all_reduce(together)
    together /= share().every
    means = together.split([gradient.numel() for gradient in gradients])
    for gradient, mean in zip(gradients, means, strict=True):
        gradient.copy_(mean.view_as(gradient))


def average_value(value: float) -> float:
    """Return the mean of a number of all processes."""
    if share().every == 1:
        return value
    numbers = torch.tensor([value], dtype=torch.float64)
    distributed.all_reduce(numbers)
    return float(numbers) / share().every
