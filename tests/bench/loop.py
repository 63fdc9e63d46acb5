"""The bare loop itself: ONNX Runtime, numpy and Pillow, nothing of Rollcast around them.

The benchmarks' programs of other serving frameworks are made of it too.
"""

import io
import os
from pathlib import Path
from typing import Literal

import numpy as np
import onnxruntime
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
MODEL = "fieldnet"
HORIZON = 40
MAX_BATCH = 8
"""Of the frameworks that have batching."""
CORES = len(os.sched_getaffinity(0))
OUTPUTS = ("positions", "covariances", "angular_velocities")


def _opened(graph: Literal["perception", "encoder", "step"]) -> onnxruntime.InferenceSession:
    """Open a graph of MODEL on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    path = ROOT / "models" / MODEL / "1" / f"{graph}.onnx"
    return onnxruntime.InferenceSession(path, options, ["CPUExecutionProvider"])


class BareLoop:
    """Perception, encoder and rollout, one call each; one thread."""

    def __init__(self) -> None:
        self._perception = _opened("perception")
        self._encoder = _opened("encoder")
        self._rollout = _opened("rollout")
        self._state = [one.name for one in self._rollout.get_inputs() if one.name != "steps"]
        self._read = [one.name for one in self._encoder.get_inputs()]
        self._first = [one.name for one in self._encoder.get_outputs()]

    def forecast(self, images: np.ndarray) -> dict[str, np.ndarray]:
        """Outputs [B, N, HORIZON, ...] from frames [B, 4, 128, 128, 3]."""
        first = self.encode(images)
        later = self.roll(first)
        return {
            name: np.moveaxis(np.concatenate([first[name][None], later[name]]), 0, 2)
            for name in OUTPUTS
        }

    def encode(self, images: np.ndarray) -> dict[str, np.ndarray]:
        """State and outputs of the first step."""
        read = self._perception.run(self._read, {"frames": images})
        seen = dict(zip(self._read, read, strict=True))
        return dict(zip(self._first, self._encoder.run(None, seen), strict=True))

    def roll(self, first: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Outputs [T, B, N, ...] of all later steps."""
        asked = {name: first[name] for name in self._state} | {"steps": np.array(HORIZON - 1)}
        return dict(zip(OUTPUTS, self._rollout.run(OUTPUTS, asked), strict=True))


def decoded(files: list[bytes]) -> np.ndarray:
    """Frames of PNG files."""
    return np.stack([np.asarray(Image.open(io.BytesIO(file))) for file in files])
