"""What every baseline that learns has in common: a loss, and forecasts of fixed sequences."""

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
    """A network that is trained on what it is given of sequences: states or frames."""

    sees_spin: bool
    """Whether it is taught angular velocity; without, it is the paper's "w/o ang. vel."."""

    @abstractmethod
    def loss(self, given: Given, progress: float) -> Tensor:
        """Return what is minimised on a batch when a share ``progress`` of the budget is gone."""

    @abstractmethod
    def forecast(self, given: Given, horizon: int) -> LearnerForecast:
        """Forecast the steps t = 0..horizon-1 of sequences, seeing no more than their start."""


def joined(parts: list[LearnerForecast]) -> LearnerForecast:
    """Join the forecasts of several batches."""
    spins = [part.angular_velocities for part in parts if part.angular_velocities is not None]
    return LearnerForecast(
        torch.cat([part.positions for part in parts]), torch.cat(spins) if spins else None
    )
