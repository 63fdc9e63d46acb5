"""How the learning rate changes, and when a training ends early."""

import math
from typing import Any, Protocol


class Schedule(Protocol):
    """Follows one training; its state goes into the checkpoints."""

    def factor(self, progress: float) -> float:
        """Factor on the learning rate when a share ``progress`` of the budget is gone."""
        ...

    def observe(self, loss: float, sequences: int) -> None:
        """Take note of the loss of a batch of ``sequences``."""
        ...

    @property
    def finished(self) -> bool:
        """Whether training should end before its budget is spent."""
        ...

    def state(self) -> dict[str, Any]:
        """Return the state for :meth:`restore`."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        ...


class Cosine:
    """Linear warm-up, then a cosine down to zero.

    Parameters
    ----------
    warm_up
        Share of the budget over which the rate rises.
    """

    finished = False

    def __init__(self, warm_up: float = 0.02) -> None:
        self._warm_up = warm_up

    def factor(self, progress: float) -> float:
        """Factor on the learning rate when a share ``progress`` of the budget is gone."""
        if progress < self._warm_up:
            return progress / self._warm_up
        return 0.5 * (1 + math.cos(math.pi * (progress - self._warm_up) / (1 - self._warm_up)))

    def observe(self, loss: float, sequences: int) -> None:
        """Do nothing: only the budget counts."""

    def state(self) -> dict[str, Any]:
        """Return nothing: the share of the budget tells all."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Do nothing."""


class Plateau:
    """A tenth of the rate after 100 epochs without a better loss, the end after 200.

    Paper, section 5.2. Training here draws windows for ever, so an epoch is as many sequences as
    the paper's training split has.
    """

    def __init__(
        self, epoch_sequences: int = 8_750, patience: int = 100, end_after: int = 200
    ) -> None:
        self._epoch_sequences = epoch_sequences
        self._patience = patience
        self._end_after = end_after
        self._factor = 1.0
        self._best = math.inf
        self._epochs_without = 0
        self._loss_sum = 0.0
        self._seen = 0

    def factor(self, progress: float) -> float:  # noqa: ARG002 - the loss alone decides
        """Factor on the learning rate."""
        return self._factor

    def observe(self, loss: float, sequences: int) -> None:
        """Compare the mean loss of every epoch with the best one before it."""
        self._loss_sum += loss * sequences
        self._seen += sequences
        if self._seen < self._epoch_sequences:
            return
        mean = self._loss_sum / self._seen
        self._loss_sum, self._seen = 0.0, 0
        if mean < self._best:
            self._best, self._epochs_without = mean, 0
            return
        self._epochs_without += 1
        if self._epochs_without % self._patience == 0:
            self._factor /= 10

    @property
    def finished(self) -> bool:
        """Whether no epoch was better for so long."""
        return self._epochs_without >= self._end_after

    def state(self) -> dict[str, Any]:
        """Return the state for :meth:`restore`."""
        return dict(vars(self))

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        vars(self).update(state)


class Exponential:
    """A rate that falls by a constant factor, down to ``end`` of the first one.

    Parameters
    ----------
    end
        Share of the first rate that is left when the budget is spent.
    """

    finished = False

    def __init__(self, end: float) -> None:
        self._end = end

    def factor(self, progress: float) -> float:
        """Factor on the learning rate when a share ``progress`` of the budget is gone."""
        return self._end**progress

    def observe(self, loss: float, sequences: int) -> None:
        """Do nothing: only the budget counts."""

    def state(self) -> dict[str, Any]:
        """Return nothing: the share of the budget tells all."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Do nothing."""
