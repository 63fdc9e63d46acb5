"""Interaction networks, the dynamics of VIN and IFS (Watters et al., 2017)."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

CODE = 64
"""Numbers of a ball's state."""
OFFSETS = (1, 2, 4)
"""Steps back of the states that the next one is predicted from."""
HISTORY = max(OFFSETS)
NEGLIGIBLE = 1e-3
"""Weight of a step below which it does not count in a loss."""


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


class SideBySide(nn.Module):
    """Weights of perceptrons of the same widths, one for each of :data:`OFFSETS`.

    Rectifiers lie between their layers.
    """

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

    def layer(self, index: int) -> tuple[Tensor, Tensor]:
        """Return weights [cores, inputs, outputs] and biases [cores, 1, outputs] of a layer."""
        return self.weights[index], self.biases[index]


class InteractionDynamics(nn.Module):
    """Dynamics of codes: one core for each of :data:`OFFSETS`, and a layer that joins them."""

    def __init__(self) -> None:
        super().__init__()
        self.cores = Cores()
        self.join = perceptron((len(OFFSETS) * CODE, 32, CODE))

    def roll_out(self, codes_BNTC: Tensor, steps: int) -> Tensor:
        """Predict the codes [B, N, steps, C] that follow some."""
        count, balls, given = codes_BNTC.shape[:3]
        history = list(codes_BNTC.permute(2, 0, 1, 3).flatten(1, 2).unbind(0))
        step = _Step(self, balls)
        for _ in range(steps):
            history.append(step(torch.stack([history[-offset] for offset in OFFSETS])))
        return torch.stack(history[given:], dim=1).unflatten(0, (count, balls))


class _Step:
    """One step of a rollout, with the dynamics' layers folded together.

    Where no rectifier lies between two layers, their product is one layer; layers with the same
    input are one layer too; the last layer of the relation is applied once, to the sum over
    pairs of balls. This saves half of the time and changes no figure beyond rounding.
    """

    def __init__(self, dynamics: InteractionDynamics, balls: int) -> None:
        cores, join = dynamics.cores, dynamics.join
        first, last = join[0], join[-1]
        assert isinstance(first, nn.Linear)
        self._balls = balls
        self._last = last
        alone_1, alone_bias_1 = cores.alone.layer(0)
        alone_2, alone_bias_2 = cores.alone.layer(1)
        affector_1, affector_bias_1 = cores.affector.layer(0)
        affector_3, affector_bias_3 = cores.affector.layer(2)
        output_1, output_bias_1 = cores.output.layer(0)
        output_2, output_bias_2 = cores.output.layer(1)
        of_code, of_effects = output_1.split((CODE, output_1.shape[1] - CODE), dim=1)
        joined = first.weight.T.unflatten(0, (len(OFFSETS), CODE))
        # Layers with a code as their input: own dynamics, output, both sides of a relation.
        widths = [alone_1, of_code]
        biases = [alone_bias_1, output_bias_1 + affector_bias_3 @ of_effects]
        effects_bias = alone_bias_2
        if balls > 1:
            relation_1, relation_bias_1 = cores.relation.layer(0)
            relation_3, relation_bias_3 = cores.relation.layer(2)
            widths += relation_1.split(CODE, dim=1)
            biases += [relation_bias_1, torch.zeros_like(relation_bias_1)]
            effects_bias = effects_bias + (balls - 1) * relation_bias_3
            self._between = cores.relation.layer(1)
            self._from_others = relation_3 @ affector_1
        self._parts = [part.shape[-1] for part in widths]
        self._enter = torch.cat(biases, -1), torch.cat(widths, -1)
        self._own = effects_bias @ affector_1 + affector_bias_1, alone_2 @ affector_1
        self._affect = cores.affector.layer(1)
        self._leave = affector_3 @ of_effects
        self._join = output_2 @ joined
        self._join_bias = (output_bias_2 @ joined).sum(0) + first.bias

    def __call__(self, codes_OMC: Tensor) -> Tensor:
        """Codes of the batch's balls, at :data:`OFFSETS`, to the next ones [M, C]."""
        bias, weight = self._enter
        own, output, *relation = torch.baddbmm(bias, codes_OMC, weight).split(self._parts, -1)
        bias, weight = self._own
        effects = torch.baddbmm(bias, own.relu(), weight)
        if relation:
            effects = torch.baddbmm(effects, self._others(*relation), self._from_others)
        weight, bias = self._affect
        affected = torch.baddbmm(bias, effects.relu(), weight).relu()
        left = torch.baddbmm(output, affected, self._leave).relu()
        return self._last((torch.bmm(left, self._join).sum(0) + self._join_bias).relu())

    def _others(self, focus_OMC: Tensor, other_OMC: Tensor) -> Tensor:
        """Sum the inputs of the relation's last layer over the other balls."""
        focus, other = (part.unflatten(1, (-1, self._balls)) for part in (focus_OMC, other_OMC))
        others = torch.stack([other.roll(k, dims=2) for k in range(1, self._balls)], dim=3)
        pairs = (focus[:, :, :, None] + others).relu()
        weight, bias = self._between
        related = torch.baddbmm(bias, pairs.flatten(1, 3), weight).relu()
        return related.view(pairs.shape).sum(dim=3).flatten(1, 2)


def annealed_weights(steps: int, progress: float) -> Tensor:
    """Weights of the rolled-out steps: the first alone at first, all alike in the end.

    A discount that rises from 0 to 1 with the share ``progress`` of the budget, normalised. Steps
    that weigh less than :data:`NEGLIGIBLE` are left out, so they need not be rolled out.
    """
    weights = torch.full((steps,), min(max(progress, 1e-6), 1.0)) ** torch.arange(steps)
    weights = weights / weights.sum()
    return weights[weights >= NEGLIGIBLE]
