"""The recurrent loop: frames in, a forecast of any horizon out, in 128-pixel units.

Axes: B requests, N balls, T steps, K frames.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

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


class RecurrentNetwork(Protocol):
    """A network that can be rolled out step by step."""

    def encode(self, frames: UInt8[np.ndarray, "B K 128 128 3"]) -> Step:
        """Return the first state and the outputs of step t = 0."""
        ...

    def advance(self, state: Arrays) -> Step:
        """Return the next state and the outputs of its step."""
        ...


def roll_out(
    network: RecurrentNetwork, frames: UInt8[np.ndarray, "B K 128 128 3"], horizon: int
) -> dict[OutputName, Float32[np.ndarray, "B N T ..."]]:
    """Forecast the steps 0..horizon-1 of frames, without other requests."""
    return roll_on(network.advance, network.encode(frames), horizon)


def roll_on(
    advance: Callable[[Arrays], Step], step: Step, horizon: int
) -> dict[OutputName, Float32[np.ndarray, "B N T ..."]]:
    """Forecast the steps 0..horizon-1, of which ``step`` is the first."""
    steps = [step.outputs]
    for _ in range(1, horizon):
        step = advance(step.state)
        steps.append(step.outputs)
    return stacked(steps)


def stacked(rows: Sequence[Outputs]) -> dict[OutputName, Float32[np.ndarray, "B N T ..."]]:
    """Stack the outputs of all steps along a new third axis, where they belong to steps."""
    return {
        name: np.stack([row[name] for row in rows], axis=2) if SPECS[name].is_per_step else first
        for name, first in rows[0].items()
    }
