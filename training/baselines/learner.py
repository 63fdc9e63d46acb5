"""Common interface of trainable baselines: a loss, and forecasts of fixed sequences."""

from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from training.baselines.states import HALF_FRAME_PX
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT

Given = TypeVar("Given")


class LearnerForecast(NamedTuple):
    """From t = 0: positions [B, N, T, 2] in 128-px units, perhaps spins [B, N, T, 3] in rad/s."""

    positions: Tensor
    angular_velocities: Tensor | None

    @classmethod
    def of(cls, positions: Tensor, spins: Tensor | None) -> "LearnerForecast":
        """Make one of the units of :mod:`training.baselines.states`."""
        spun = None if spins is None else ANGULAR_VELOCITY_UNIT * spins
        return cls(HALF_FRAME_PX * (1 + positions), spun)

    def arrays(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return both as arrays."""
        spins = self.angular_velocities
        return self.positions.numpy(), None if spins is None else spins.numpy()


class Learner(nn.Module, ABC, Generic[Given]):
    """Network that is trained on the states or the frames of sequences."""

    sees_spin: bool
    """Supervision by angular velocities; without it, this is the paper's "w/o ang. vel."."""

    @abstractmethod
    def loss(self, given: Given, progress: float) -> Tensor:
        """Return the loss of a batch after the fraction ``progress`` of the budget."""

    @abstractmethod
    def forecast(self, given: Given, horizon: int) -> LearnerForecast:
        """Forecast the steps t = 0..horizon-1 of sequences, seeing no more than their start."""


def joined(parts: list[LearnerForecast]) -> LearnerForecast:
    """Join the forecasts of several batches."""
    spins = [part.angular_velocities for part in parts if part.angular_velocities is not None]
    return LearnerForecast(
        torch.cat([part.positions for part in parts]), torch.cat(spins) if spins else None
    )
