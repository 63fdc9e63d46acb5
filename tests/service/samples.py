"""Frames, bodies, damaged files and a predictor whose answers can be computed by hand."""

import base64
import io
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from rollcast.manifest import HASHED_FILES, Manifest
from rollcast.ood import OodDetector
from rollcast.outputs import SPECS
from rollcast.rollout import Arrays, Step, Steps
from service.http.image_decoding import OpenedFrames
from service.serving.registry import Model, Registry

UNITS = {
    "positions": "px",
    "covariances": "px^2",
    "angular_velocities": "rad/s",
    "final_positions": "px",
}


def dot(x: float, y: float, side: int = 128) -> np.ndarray:
    """A black frame with a white square around a point that is given in 128-pixel units."""
    pixels = np.arange(side)
    half = 4 * side / 128

    def covered(centre: float) -> np.ndarray:
        return np.clip(
            np.minimum(pixels + 1, centre + half) - np.maximum(pixels, centre - half), 0, 1
        )

    square = np.outer(covered(y * side / 128), covered(x * side / 128))
    return (255 * square[..., None].repeat(3, axis=2)).round().astype(np.uint8)


def png(frame: np.ndarray) -> bytes:
    return encode(Image.fromarray(frame), "PNG")


def encode(image: Image.Image, kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def decode_frames(
    images: Sequence[bytes], fields: Sequence[str], check: Callable[[], None] = lambda: None
) -> tuple[np.ndarray, int]:
    """Decode frames; return them and the side that they had."""
    opened = OpenedFrames(images, fields, check)
    return opened.decode(), opened.side


def moving_dot(side: int = 128, frames: int = 4) -> list[bytes]:
    """Frames of a dot at (40, 60), (42, 61), ... in 128-pixel units."""
    return [png(dot(40 + 2 * index, 60 + index, side)) for index in range(frames)]


def body(images: list[bytes] | None = None, **fields: object) -> dict[str, object]:
    images = moving_dot() if images is None else images
    return {"frames": [base64.b64encode(image).decode() for image in images], **fields}


def parts(images: list[bytes]) -> list[tuple[str, tuple[str, bytes]]]:
    return [("frames", ("frame.png", image)) for image in images]


def png_header(width: int, height: int) -> bytes:
    """A PNG of that size whose pixels are all zero, and compress to almost nothing."""
    packer = zlib.compressobj(9)
    pixels = packer.compress(bytes(10_000_000)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = png_chunk(b"IHDR", header) + png_chunk(b"IDAT", pixels) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def png_chunk(kind: bytes, data: bytes) -> bytes:
    checksum = struct.pack(">I", zlib.crc32(kind + data))
    return struct.pack(">I", len(data)) + kind + data + checksum


def manifest(**changes: object) -> Manifest:
    """The manifest of a probabilistic model of one ball, with some fields changed."""
    fields: dict[str, object] = {
        "format_version": 3,
        "name": "dot",
        "version": 1,
        "default": True,
        "variant": "dotnet",
        "preset": "fake",
        "scenarios": ["hemisphere", "ellipsoid", "heightfield"],
        "objects": 1,
        "observed_frames": 4,
        "frames": 4,
        "final_step": None,
        "frame_rate_hz": 40,
        "frame_size": 128,
        "trained_horizon": 20,
        "state": [{"name": "position", "shape": [1, 2]}, {"name": "velocity", "shape": [1, 2]}],
        "covariance": {"source": "predicted"},
        "angular_velocity": True,
        "training": {"seed": 1},
        "metrics": [],
        "validation_error_px": 3.0,
        "licence": "Apache-2.0",
        "files": dict.fromkeys(HASHED_FILES, 64 * "0"),
    } | changes
    names = ["positions"]
    names += ["covariances"] if fields["covariance"]["source"] == "predicted" else []
    names += ["angular_velocities"] if fields["angular_velocity"] else []
    names += ["final_positions"] if fields["final_step"] is not None else []
    derived: dict[str, object] = {
        "outputs": [
            {"name": name, "shape": (fields["objects"], *SPECS[name].shape), "unit": UNITS[name]}
            for name in names
        ],
        "parity": {"max_abs_error": {}, "tolerance": {}},
        "golden_tolerance": dict.fromkeys(names, 1e-3),
    }
    return Manifest.model_validate(derived | fields)


def one_by_one(step: Callable[[Arrays], Step], state: Arrays, steps: int) -> Steps:
    """Take steps one after the other."""
    made = []
    for _ in range(steps):
        taken = step(state)
        state = taken.state
        made.append(taken.outputs)
    return Steps(state, {name: np.stack([one[name] for one in made]) for name in made[0]})


class DotPredictor:
    """Follows the white square along a straight line.

    Covariances are ``sigma`` squared along each axis.
    """

    def __init__(
        self, manifest: Manifest, ood_detector: OodDetector | None = None, sigma: float = 1
    ) -> None:
        self.manifest = manifest
        self.ood_detector = ood_detector
        self.sigma = sigma

    def encode(self, frames: np.ndarray, *, two_cores: bool = False) -> Step:
        positions = _centroids(frames)[:, :, None].repeat(self.manifest.objects, axis=2)
        step = self._step(positions[:, 3], positions[:, 3] - positions[:, 2])
        if self.manifest.final_step is None:
            return step
        return Step(step.state, {**step.outputs, "final_positions": positions[:, 4]})

    def advance(self, state: Arrays, steps: int) -> Steps:
        return one_by_one(self.step, state, steps)

    def step(self, state: Arrays) -> Step:
        return self._step(state["position"] + state["velocity"], state["velocity"])

    def _step(self, position: np.ndarray, velocity: np.ndarray) -> Step:
        outputs = {"positions": position}
        if self.manifest.covariance.source == "predicted":
            outputs["covariances"] = np.broadcast_to(
                self.sigma**2 * np.eye(2, dtype=np.float32), (*position.shape, 2)
            )
        if self.manifest.angular_velocity:
            outputs["angular_velocities"] = np.ones((*position.shape[:2], 3), np.float32)
        return Step({"position": position, "velocity": velocity}, outputs)


def _centroids(frames: np.ndarray) -> np.ndarray:
    """Centre of brightness, [B, K, 2] in pixels."""
    light = frames.mean(axis=-1) + 1e-9
    centres = np.arange(128) + 0.5
    x = (light.sum(axis=2) * centres).sum(axis=-1) / light.sum(axis=(2, 3))
    y = (light.sum(axis=3) * centres).sum(axis=-1) / light.sum(axis=(2, 3))
    return np.stack([x, y], axis=-1).astype(np.float32)


def served(**changes: object) -> Model:
    """A model that is ready."""
    described = manifest(**changes)
    predictor = DotPredictor(described)
    return Model(described.name, described.version, described, predictor, card="# A card\n")


EMPIRICAL = {"source": "empirical", "empirical": [[[1, 0.5], [0.5, 1]], [[4, 0], [0, 4]]]}


def registry(_: Path, name: str | None = None) -> Registry:
    """One of each kind."""
    return Registry(
        [
            served(),
            served(name="dot", version=2, default=False, validation_error_px=0.1),
            served(name="line", covariance=EMPIRICAL, angular_velocity=False),
            served(name="bowl", scenarios=["hemisphere"], validation_error_px=1.0),
            served(name="between", frames=5, final_step=9, covariance=EMPIRICAL),
            served(name="pair", objects=2),
            Model("broken", 1, reason="manifest.json is missing"),
        ]
    )
