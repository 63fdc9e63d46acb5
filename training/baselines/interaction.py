"""Interaction networks: what VIN and IFS roll states out with (Watters et al., 2017)."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

CODE = 64
"""Numbers of a ball's state."""
OFFSETS = (1, 2, 4)
"""Steps back of the states that the next one is predicted from."""
HISTORY = max(OFFSETS)


def perceptron(widths: Sequence[int], *, rectified_end: bool = False) -> nn.Sequential:
    """Make dense layers with rectifiers between them, and perhaps after the last."""
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(pairwise(widths)):
        layers.append(nn.Linear(inputs, outputs))
        if rectified_end or index < len(widths) - 2:
            layers.append(nn.ReLU())
    return nn.Sequential(*layers)


class Cores(nn.Module):
    """An interaction core for each of :data:`OFFSETS`, side by side in every product.

    A core is a ball's own dynamics plus the summed effects of every other ball on it.
    """

    def __init__(self) -> None:
        super().__init__()
        self.alone = SideBySide((CODE, 64, 64))
        self.relation = SideBySide((2 * CODE, 64, 64, 64))
        self.affector = SideBySide((64, 64, 64, 64))
        self.output = SideBySide((CODE + 64, 32, CODE))

    def forward(self, codes_OBNC: Tensor) -> Tensor:
        """Codes, a core's each, to what the cores make of the next ones."""
        effects = self.alone(codes_OBNC) + self._from_others(codes_OBNC)
        return self.output(torch.cat([codes_OBNC, self.affector(effects)], dim=-1))

    def _from_others(self, codes_OBNC: Tensor) -> Tensor:
        balls = codes_OBNC.shape[2]
        if balls == 1:
            return torch.zeros_like(codes_OBNC)
        focus = codes_OBNC[:, :, :, None].expand(-1, -1, -1, balls, -1)
        other = codes_OBNC[:, :, None].expand(-1, -1, balls, -1, -1)
        related = self.relation(torch.cat([focus, other], dim=-1))
        others = 1 - torch.eye(balls)[:, :, None]
        return (related * others).sum(dim=3)


class SideBySide(nn.Module):
    """Perceptrons of the same widths, one for each of :data:`OFFSETS`, with rectifiers between."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for inputs, outputs in pairwise(widths):
            # As torch begins dense layers.
            bound = inputs**-0.5
            cores = len(OFFSETS)
            self.weights.append(torch.empty(cores, inputs, outputs).uniform_(-bound, bound))
            self.biases.append(torch.empty(cores, 1, outputs).uniform_(-bound, bound))

    def forward(self, x: Tensor) -> Tensor:
        """Apply each to its own part along the first axis."""
        y = x.flatten(1, -2)
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            y = torch.baddbmm(bias, y if index == 0 else y.relu(), weight)
        return y.unflatten(1, x.shape[1:-1])


class InteractionDynamics(nn.Module):
    """The next code from those of :data:`OFFSETS` steps back: a core each, and what joins them."""

    def __init__(self) -> None:
        super().__init__()
        self.cores = Cores()
        self.join = perceptron((len(OFFSETS) * CODE, 32, CODE))

    def forward(self, history: Sequence[Tensor]) -> Tensor:
        """Predict the code [B, N, C] after the last of a history of at least HISTORY codes."""
        candidates = self.cores(torch.stack([history[-offset] for offset in OFFSETS]))
        return self.join(torch.cat(candidates.unbind(0), dim=-1))

    def roll_out(self, codes_BNTC: Tensor, steps: int) -> Tensor:
        """Predict the codes [B, N, steps, C] that follow some."""
        history = list(codes_BNTC.unbind(2))
        for _ in range(steps):
            history.append(self(history))
        return torch.stack(history[codes_BNTC.shape[2] :], dim=2)


def annealed_weights(steps: int, progress: float) -> Tensor:
    """Weights of the rolled-out steps: the first alone at first, all alike in the end.

    A discount that rises from 0 to 1 with the share ``progress`` of the budget, normalised.
    """
    weights = torch.full((steps,), min(max(progress, 1e-6), 1.0)) ** torch.arange(steps)
    return weights / weights.sum()
