"""Inputs and outputs of the perception graph, shared by the service and the export checks."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from rollcast.manifest import FRAMES_INPUT
from rollcast.trajectory import OBSERVED_FRAMES

PLACES = "places"
"""Output of the perception graph: ball positions in the last frame, [B, N, 2]."""
FINALS = "finals"
"""Input of the encoder's graph of a network that also reads a final frame: the positions there."""

Run = Callable[[Sequence[str], dict[str, Any]], Sequence[np.ndarray]]
"""Function that runs a graph: names of outputs, and inputs by name, to outputs [B, ...]."""


def run_perception(
    run: Run, wanted: Sequence[str], frames: UInt8[np.ndarray, "B K 128 128 3"]
) -> dict[str, np.ndarray]:
    """Return the encoder's inputs for the frames.

    A final frame is passed as four frames of balls at rest, in the same run (decisions 0019, 0112).

    Parameters
    ----------
    run
        Function that runs the perception graph.
    wanted
        Names of the encoder's inputs.
    """
    if FINALS not in wanted:
        return dict(zip(wanted, run(wanted, {FRAMES_INPUT: frames}), strict=True))
    at_rest = np.repeat(frames[:, OBSERVED_FRAMES:], OBSERVED_FRAMES, axis=1)
    seen = np.concatenate([frames[:, :OBSERVED_FRAMES], at_rest])
    asked = [PLACES if name == FINALS else name for name in wanted]
    observed, final = slice(len(frames)), slice(len(frames), None)
    return {
        name: values[final if name == FINALS else observed]
        for name, values in zip(wanted, run(asked, {FRAMES_INPUT: seen}), strict=True)
    }
