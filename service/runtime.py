"""ONNX Runtime: the only module that imports it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rollcast.manifest import (
    ENCODER_FILE,
    FRAMES_INPUT,
    NEXT_PREFIX,
    STEP_FILE,
    Manifest,
    OutputName,
)
from service.rollout import Arrays, Step
from service.settings import keep_runtime_silent

keep_runtime_silent()
import onnxruntime  # noqa: E402


class OnnxPredictor:
    """The two graphs of an artefact. Safe to call from several threads at once.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    manifest
        Its manifest, which names the graphs' tensors.
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.manifest = manifest
        self._encoder = _session(folder / ENCODER_FILE)
        self._step = _session(folder / STEP_FILE)
        self._state = [tensor.name for tensor in manifest.state]
        self._first = list(manifest.output_names)
        self._later = list(manifest.step_output_names)
        self._encoded = [*self._state, *self._first]
        self._stepped = [*(f"{NEXT_PREFIX}{name}" for name in self._state), *self._later]

    def encode(self, frames: UInt8[np.ndarray, "B K 128 128 3"]) -> Step:
        """Return the first state and the outputs of step t = 0."""
        return self._as_step(self._encoder.run(self._encoded, {FRAMES_INPUT: frames}), self._first)

    def advance(self, state: Arrays) -> Step:
        """Return the next state and the outputs of its step."""
        return self._as_step(self._step.run(self._stepped, state), self._later)

    def _as_step(self, values: list[np.ndarray], outputs: Sequence[OutputName]) -> Step:
        split = len(self._state)
        return Step(
            dict(zip(self._state, values[:split], strict=True)),
            dict(zip(outputs, values[split:], strict=True)),
        )


def _session(path: Path) -> onnxruntime.InferenceSession:
    """Open a graph on one thread that never spins: the cores belong to other requests."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3  # errors: its warnings speak to those who export
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # An arena for every session would keep the most that its largest batch ever needed.
    options.enable_cpu_mem_arena = False
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
