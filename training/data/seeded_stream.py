"""Endless streams of training batches that a run can resume at any batch."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import torch
from torch.utils.data import IterableDataset

Item = TypeVar("Item", covariant=True)
"""A batch."""


class SeededStream(IterableDataset[Item]):
    """Endless batches; batch k depends on the seed and on k alone.

    Parameters
    ----------
    seed
        Seed of all batches.
    first_batch
        Number of the first batch.
    """

    def __init__(self, seed: int, first_batch: int) -> None:
        self._seed = seed
        self._first_batch = first_batch

    def __iter__(self) -> Iterator[Item]:
        """Batches from ``first_batch`` on; several loader processes share them out in turn."""
        worker = torch.utils.data.get_worker_info()
        first, stride = (0, 1) if worker is None else (worker.id, worker.num_workers)
        number = self._first_batch + first
        while True:
            yield self._batch(np.random.default_rng([self._seed, number]), number)
            number += stride

    @abstractmethod
    def _batch(self, generator: np.random.Generator, number: int) -> Item:
        """Return the batch of a number; its generator is seeded with the seed and the number."""
