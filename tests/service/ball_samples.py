"""A model for any number of balls whose graphs are computed by hand: white dots on black."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rollcast.manifest import (
    BALL_FILES,
    BALL_INPUTS,
    DETECTOR_FILE,
    ENCODER_FILE,
    REFINER_FILE,
    ROLLOUT_FILE,
)
from service.inference.ball_predictor import BallPredictor
from service.serving.registry import Model
from tests.rollcast import dot_balls
from tests.service.samples import encode, manifest


def dots(paths: np.ndarray, height: int, width: int) -> list[np.ndarray]:
    """Four frames of soft white dots [balls, 4, 2], pixels, wide as an eighth of a cell's row."""
    y, x = np.mgrid[:height, :width] + 0.5
    spread = max(height, width) / 64
    frames = []
    for seen in np.asarray(paths).swapaxes(0, 1):
        light = sum(
            np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * spread**2)) for a, b in seen.tolist()
        )
        frames.append(
            np.repeat((255 * np.clip(light, 0, 1)).astype(np.uint8)[..., None], 3, axis=-1)
        )
    return frames


def files(frames: Sequence[np.ndarray]) -> list[bytes]:
    from PIL import Image

    return [encode(Image.fromarray(frame), "PNG") for frame in frames]


def _detect(frames: np.ndarray) -> dict[str, np.ndarray]:
    said = dot_balls.detect(frames)
    return said | {"scores": np.minimum(2 * said["scores"], 1)}


def _refine(patches: np.ndarray) -> dict[str, np.ndarray]:
    return dot_balls.refine(patches) | {"log_sigmas": np.full((len(patches), 2), -6.0)}


def _outputs(positions: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "positions": (64 + 64 * positions).astype(np.float32),
        "covariances": np.broadcast_to(np.eye(2, dtype=np.float32), (*positions.shape, 2)),
        "angular_velocities": np.zeros((*positions.shape[:2], 3), np.float32),
    }


def _encode(**seen: np.ndarray) -> dict[str, np.ndarray]:
    """Balls that go on as they went: a state of places and velocities."""
    assert set(BALL_INPUTS) < set(seen)
    places = seen["places"]
    shift = places[:, :, -1] - places[:, :, -2]
    state = {"position": places[:, :, -1], "velocity": shift / seen["spacing"][:, None, None]}
    return state | _outputs(places[:, :, -1])


def _roll(position: np.ndarray, velocity: np.ndarray, steps: np.ndarray) -> dict[str, np.ndarray]:
    moved = [position + (1 + step) * velocity for step in range(int(steps))]
    outputs = [_outputs(each) for each in moved]
    stacked = {name: np.stack([one[name] for one in outputs]) for name in outputs[0]}
    return {"next_position": moved[-1], "next_velocity": velocity} | stacked


_GRAPHS = {
    DETECTOR_FILE: _detect,
    REFINER_FILE: _refine,
    ENCODER_FILE: _encode,
    ROLLOUT_FILE: _roll,
}


class _Graph:
    """Runs a function as a graph is run."""

    def __init__(self, path: Path) -> None:
        self._compute = _GRAPHS[path.name]

    def run(self, outputs: Sequence[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        made = self._compute(**inputs)
        return [made[name] for name in outputs]


def served_balls(**changes: object) -> Model:
    """A model for any number of balls that is ready."""
    described = manifest(
        **{
            "format_version": 3,
            "name": "dots",
            "max_objects": 8,
            "kinematic": {"acceleration_ratio": 0.1, "level_slope": 0.0},
            "files": dict.fromkeys(BALL_FILES, 64 * "0"),
            "state": [
                {"name": "position", "shape": [3, 32, 32]},
                {"name": "velocity", "shape": [1, 2]},
            ],
        }
        | changes
    )
    predictor = BallPredictor(Path(), described, _Graph)
    return Model(described.name, described.version, described, predictor, card="# A card\n")
