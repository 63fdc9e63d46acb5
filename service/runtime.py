"""ONNX Runtime: the only module that imports it."""

from collections.abc import Sequence
from pathlib import Path
from threading import Lock
from weakref import WeakValueDictionary

import numpy as np
from jaxtyping import UInt8

from rollcast.manifest import (
    ENCODER_FILE,
    EYE_FILE,
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

_eyes: WeakValueDictionary[str, onnxruntime.InferenceSession] = WeakValueDictionary()
_opening = Lock()


class OnnxPredictor:
    """The graphs of an artefact. Safe to call from several threads at once.

    The eye, by far the largest of them, is shared with other models that have the same.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    manifest
        Its manifest, which names the graphs' tensors.
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.manifest = manifest
        eye = manifest.files.get(EYE_FILE)
        self._eye = None if eye is None else _shared_eye(folder / EYE_FILE, eye)
        self._encoder = _session(folder / ENCODER_FILE)
        self._read = [one.name for one in self._encoder.get_inputs()]
        self._step = _session(folder / STEP_FILE)
        self._state = [tensor.name for tensor in manifest.state]
        self._first = list(manifest.output_names)
        self._later = list(manifest.step_output_names)
        self._encoded = [*self._state, *self._first]
        self._stepped = [*(f"{NEXT_PREFIX}{name}" for name in self._state), *self._later]

    def encode(self, frames: UInt8[np.ndarray, "B K 128 128 3"]) -> Step:
        """Return the first state and the outputs of step t = 0."""
        seen = {FRAMES_INPUT: frames}
        if self._eye is not None:
            seen = dict(zip(self._read, self._eye.run(self._read, seen), strict=True))
        return self._as_step(self._encoder.run(self._encoded, seen), self._first)

    def advance(self, state: Arrays) -> Step:
        """Return the next state and the outputs of its step."""
        return self._as_step(self._step.run(self._stepped, state), self._later)

    def _as_step(self, values: list[np.ndarray], outputs: Sequence[OutputName]) -> Step:
        split = len(self._state)
        return Step(
            dict(zip(self._state, values[:split], strict=True)),
            dict(zip(outputs, values[split:], strict=True)),
        )


def _shared_eye(path: Path, digest: str) -> onnxruntime.InferenceSession:
    """Open an eye, unless one with the same sha256 is open."""
    with _opening:
        eye = _eyes.get(digest)
        if eye is None:
            eye = _eyes[digest] = _session(path)
        return eye


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
