"""The recurrent loop: frames in, a forecast of any horizon out, in 128-pixel units.

Axes: B requests, N balls, T steps, K frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float32, UInt8

from rollcast.manifest import NEXT_PREFIX
from rollcast.outputs import SPECS, OutputName

Arrays = Mapping[str, np.ndarray]
Outputs = Mapping[OutputName, np.ndarray]


@dataclass(frozen=True)
class Step:
    """The state after a step, by name, and the step's outputs, each [B, N, ...]."""

    state: Arrays
    outputs: Outputs

    @classmethod
    def split(cls, values: Mapping[str, np.ndarray], outputs: Sequence[OutputName]) -> "Step":
        """Split the values that a graph returned, by name, into the state and the outputs."""
        return cls(
            {
                name.removeprefix(NEXT_PREFIX): value
                for name, value in values.items()
                if name not in outputs
            },
            {name: values[name] for name in outputs},
        )

    @property
    def as_steps(self) -> Outputs:
        """Outputs [1, B, N, ...], those of no step [B, N, ...]."""
        return {
            name: values[None] if SPECS[name].is_per_step else values
            for name, values in self.outputs.items()
        }


class Steps(NamedTuple):
    """The state after some steps, by name, and the outputs [T, B, N, ...] of each."""

    state: Arrays
    outputs: Outputs


class RecurrentNetwork(Protocol):
    """A network that can be rolled out step by step."""

    def encode(self, frames: UInt8[np.ndarray, "B K 128 128 3"]) -> Step:
        """Return the first state and the outputs of step t = 0."""
        ...

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        ...


def roll_out(
    network: RecurrentNetwork, frames: UInt8[np.ndarray, "B K 128 128 3"], horizon: int
) -> dict[OutputName, Float32[np.ndarray, "B N T ..."]]:
    """Forecast the steps 0..horizon-1 of frames, without other requests."""
    first = network.encode(frames)
    parts = [first.as_steps]
    if horizon > 1:
        parts.append(network.advance(first.state, horizon - 1).outputs)
    return joined(parts)


def part_of_steps(outputs: Outputs, part: slice) -> Outputs:
    """Return some steps of outputs [T, B, N, ...]; those of no step stay as they are."""
    return {
        name: values[part] if SPECS[name].is_per_step else values
        for name, values in outputs.items()
    }


def finite_steps(outputs: Outputs) -> int:
    """Count the steps of outputs [T, B, N, ...] before the first one that is not finite."""
    of_steps = [values for name, values in outputs.items() if SPECS[name].is_per_step]
    finite = np.all([np.isfinite(v).all(axis=tuple(range(1, v.ndim))) for v in of_steps], axis=0)
    return len(finite) if finite.all() else int(finite.argmin())


def joined(parts: Sequence[Outputs]) -> dict[OutputName, Float32[np.ndarray, "B N T ..."]]:
    """Join consecutive steps of outputs [T, B, N, ...]; the first part has those of no step."""
    return {
        name: np.moveaxis(np.concatenate([part[name] for part in parts]), 0, 2)
        if SPECS[name].is_per_step
        else first
        for name, first in parts[0].items()
    }
