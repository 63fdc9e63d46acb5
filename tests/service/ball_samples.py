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
    STEP_FILE,
)
from service.inference.ball_predictor import BallPredictor
from service.serving.registry import Model
from tests.service.samples import encode, manifest

CELLS = 32
RADIUS = 4 / 64


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
    cells = frames[0, -1, ..., 0].reshape(CELLS, 4, CELLS, 4).mean(axis=(1, 3)) / 255
    along = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1
    x, y = np.meshgrid(along, along)
    order = np.argsort(-cells, axis=None)[:16]
    places = np.stack([np.stack([x, y], axis=-1).reshape(-1, 2)[order]] * 4, axis=1)
    votes = np.stack([x, y] * 4 + [np.full_like(x, np.log(RADIUS)), cells, np.ones_like(x)])
    return {
        "places": places[None],
        "radii": np.full((1, 16), RADIUS),
        "scores": np.minimum(2 * cells, 1).reshape(-1)[order][None],
        "moving": np.ones((1, 16)),
        "votes": votes[None],
        "ground": np.zeros((1, 3, CELLS, CELLS)),
        "scene": np.zeros((1, 2)),
    }


def _refine(patches: np.ndarray) -> dict[str, np.ndarray]:
    bright = np.clip(patches[:, :, 0] + 1, 0, None) + 1e-9
    along = (np.arange(32) + 0.5) / 16 - 1
    x, y = np.meshgrid(along, along)
    total = bright.sum(axis=(2, 3))
    offsets = np.stack([(bright * x).sum(axis=(2, 3)), (bright * y).sum(axis=(2, 3))], axis=-1)
    offsets = offsets / total[..., None]
    count = len(patches)
    return {
        "offsets": offsets,
        "log_radius": np.full(count, np.log(0.5)),
        "visible": np.where(total > 1, 8.0, -8.0),
        "log_sigmas": np.full((count, 2), -6.0),
        "features": np.zeros((count, 128)),
    }


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
    state = {"position": places[:, :, -1], "velocity": places[:, :, -1] - places[:, :, -2]}
    return state | _outputs(places[:, :, -1])


def _step(position: np.ndarray, velocity: np.ndarray) -> dict[str, np.ndarray]:
    moved = position + velocity
    return {"next_position": moved, "next_velocity": velocity} | _outputs(moved)


_GRAPHS = {
    DETECTOR_FILE: _detect,
    REFINER_FILE: _refine,
    ENCODER_FILE: _encode,
    STEP_FILE: _step,
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
            "format_version": 2,
            "name": "dots",
            "max_objects": 8,
            "kinematic": {"acceleration_px": 0.1, "level_slope": 0.0},
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
