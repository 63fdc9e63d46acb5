"""VIN, the visual interaction network (Watters et al., 2017): states read from small frames.

Pairs of consecutive frames become vectors of every ball, neighbouring pairs a state code; the codes
are rolled out as IFS' are. The publication sees six frames, which give the four codes that its
dynamics look back on; four frames give two, and the older ones are taken to be like the first.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.baselines.interaction import (
    CODE,
    HISTORY,
    InteractionDynamics,
    annealed_weights,
    perceptron,
)
from training.baselines.learner import Learner, LearnerForecast
from training.baselines.states import HALF_FRAME_PX, VELOCITY_UNIT
from training.data.windows import Batch

FRAME = 32
"""Side of the frames that it sees, pixels."""
PAIR = 32
"""Numbers that a pair of frames becomes before they are shared out among the balls."""
WIDE, FINE = (10, 4), (3, 16)
"""Kernel and channels of the two stacks through which every pair goes."""
POOLED = (16, 16, 16, 32, PAIR)
"""Channels of the convolutions, each followed by pooling, that bring a pair down to one cell."""


class PairEncoder(nn.Module):
    """Two consecutive frames to a vector of every ball."""

    def __init__(self, objects: int) -> None:
        super().__init__()
        self.objects = objects
        self.stacks = nn.ModuleList(
            _convolutions(kernel, [6, channels, channels]) for kernel, channels in (WIDE, FINE)
        )
        self.joined = _convolutions(3, [WIDE[1] + FINE[1], 16, 16])
        inputs = [16 + 2, *POOLED]
        self.pooled = nn.Sequential(
            *(
                nn.Sequential(_convolutions(3, list(pair)), nn.MaxPool2d(2))
                for pair in pairwise(inputs)
            )
        )
        self.share = nn.Linear(PAIR, objects * CODE)

    def forward(self, pairs_B6HW: Tensor) -> Tensor:
        """Pairs of frames to vectors [B, N, C]."""
        x = self.joined(torch.cat([stack(pairs_B6HW) for stack in self.stacks], dim=1))
        along = torch.linspace(-1, 1, x.shape[-1])
        rows, columns = torch.meshgrid(along, along, indexing="ij")
        place = torch.stack([columns, rows]).expand(len(x), -1, -1, -1)
        seen = self.pooled(torch.cat([x, place], dim=1)).flatten(1)
        return self.share(seen).unflatten(1, (self.objects, CODE))


class Vin(Learner[Batch]):
    """Visual interaction network without angular velocity, as in the paper's table.

    Parameters
    ----------
    horizon
        T_train.
    """

    sees_spin = False

    def __init__(self, objects: int, horizon: int) -> None:
        super().__init__()
        self._horizon = horizon
        self.pairs = PairEncoder(objects)
        self.triplets = perceptron((2 * CODE, 64, CODE))
        self.dynamics = InteractionDynamics()
        self.decoder = nn.Linear(CODE, 4)

    def loss(self, given: Batch, progress: float) -> Tensor:
        """Squared errors of the steps after t = 0, and of t = 0 as the frames' code tells it."""
        weights = annealed_weights(self._horizon - 1, progress)
        horizon = 1 + len(weights)
        positions = given["positions"][:, :, :horizon] / HALF_FRAME_PX - 1
        velocities = (positions[:, :, 1:] - positions[:, :, :-1]) / VELOCITY_UNIT
        states = self._states(given["frames"], horizon)
        now = (states[:, :, 0, :2] - positions[:, :, 0]).square().sum(-1).mean()
        later = torch.cat([positions[:, :, 1:], velocities], dim=-1)
        errors = (states[:, :, 1:] - later).square().sum(-1).mean(dim=(0, 1))
        return now + (weights * errors).sum()

    def forecast(self, given: Batch, horizon: int) -> LearnerForecast:
        """Read the states of the frames and roll them out."""
        return LearnerForecast.of(self._states(given["frames"], horizon)[..., :2], None)

    def _states(self, frames_BKHW3: Tensor, horizon: int) -> Tensor:
        """Positions and velocities [B, N, T, 4] from t = 0 on."""
        codes = self._codes(frames_BKHW3)
        history = torch.cat([codes[:, :, :1].expand(-1, -1, HISTORY - 2, -1), codes], dim=2)
        later = self.dynamics.roll_out(history, horizon - 1)
        return self.decoder(torch.cat([codes[:, :, -1:], later], dim=2))

    def _codes(self, frames_BKHW3: Tensor) -> Tensor:
        """Codes [B, N, 2, C] of t = -1 and t = 0."""
        count = frames_BKHW3.shape[1]
        flat = frames_BKHW3.flatten(0, 1).permute(0, 3, 1, 2).float() / 255 - 0.5
        small = functional.avg_pool2d(flat, flat.shape[-1] // FRAME).unflatten(0, (-1, count))
        pairs = torch.cat([small[:, :-1], small[:, 1:]], dim=2)
        seen = self.pairs(pairs.flatten(0, 1)).unflatten(0, (-1, count - 1))
        codes = self.triplets(torch.cat([seen[:, :-1], seen[:, 1:]], dim=-1))
        return codes.transpose(1, 2)


def _convolutions(kernel: int, channels: list[int]) -> nn.Sequential:
    """Make convolutions that keep the size, each rectified."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(channels):
        before, after = (kernel - 1) // 2, kernel // 2
        padded = nn.ZeroPad2d((before, after, before, after))
        layers += [padded, nn.Conv2d(inputs, outputs, kernel), nn.ReLU()]
    return nn.Sequential(*layers)
