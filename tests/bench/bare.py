"""The bare loop: ONNX Runtime and the committed graphs, with nothing around them.

python -m tests.bench.bare MODEL --seconds 5 [--decode]

Prints the times of its forecasts as JSON. With ``--decode`` every forecast begins with four PNG
files, as a request does.
"""

import argparse
import io
import json
import time
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

from tests.bench.payloads import HORIZON, frames, png_files

ROOT = Path(__file__).resolve().parents[2]


def opened(path: Path) -> onnxruntime.InferenceSession:
    """Open a graph on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(path, options, ["CPUExecutionProvider"])


class BareLoop:
    """Encoder once, step HORIZON - 1 times; one thread."""

    def __init__(self, folder: Path) -> None:
        self._encoder = opened(folder / "encoder.onnx")
        self._step = opened(folder / "step.onnx")
        self._state = [one.name for one in self._step.get_inputs()]
        self._first = [one.name for one in self._encoder.get_outputs()]
        self._next = [one.name for one in self._step.get_outputs()]

    def forecast(self, images: np.ndarray) -> np.ndarray:
        """Positions [HORIZON, N, 2] from four frames."""
        found = dict(
            zip(self._first, self._encoder.run(None, {"frames": images[None]}), strict=True)
        )
        positions = [found["positions"][0]]
        state = {name: found[name] for name in self._state}
        for _ in range(HORIZON - 1):
            found = dict(zip(self._next, self._step.run(None, state), strict=True))
            positions.append(found["positions"][0])
            state = {name: found[f"next_{name}"] for name in self._state}
        return np.stack(positions)


def decoded(files: list[bytes]) -> np.ndarray:
    """Frames of four PNG files."""
    return np.stack([np.asarray(Image.open(io.BytesIO(file))) for file in files])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--decode", action="store_true")
    arguments = parser.parse_args()
    loop = BareLoop(ROOT / "models" / arguments.model / "1")
    images = frames()
    files = png_files(images)
    loop.forecast(images)
    times: list[float] = []
    end = time.perf_counter() + arguments.seconds
    while (begun := time.perf_counter()) < end:
        loop.forecast(decoded(files) if arguments.decode else images)
        times.append(time.perf_counter() - begun)
    print(json.dumps(times))


if __name__ == "__main__":
    main()
