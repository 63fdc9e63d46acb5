"""Measures a running service on the simulator's own frames after they were perturbed.

    python -m training perturbations http://127.0.0.1:8000

Scenes are those of the test split. The same scenes are forecast before and after each perturbation,
and a perturbation's figure is the error at T=20 relative to the unperturbed one.
"""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.client import Client
from rollcast.markdown import table
from rollcast.trajectory import OBSERVED_FRAMES
from training.data.windows import Window
from training.evaluation.evaluate import EvaluationSet, Shown

STEP = 19
"""Index of T=20."""
HORIZON = STEP + 1
CHI_SQUARED_95 = 5.991
MIDDLE = NETWORK_FRAME_SIZE / 2

Frames = UInt8[np.ndarray, "4 128 128 3"]
Perturb = Callable[[Frames, np.random.Generator], Frames]
Move = Callable[[np.ndarray], np.ndarray]
"""Places of the original frames to those of the perturbed ones, pixels."""


@dataclass(frozen=True)
class Perturbation:
    """Perturbation of frames, with its effect on positions."""

    name: str
    change: Perturb
    move: Move = lambda places: places


def _pixelwise(change: Callable[[np.ndarray], np.ndarray]) -> Perturb:
    """Return a perturbation of colours, from and to 0..1."""

    def perturb(frames: Frames, _: np.random.Generator) -> Frames:
        return (255 * np.clip(change(frames / 255), 0, 1)).round().astype(np.uint8)

    return perturb


def _disc(color: tuple[int, int, int]) -> Perturb:
    """Return a perturbation that adds a shaded ball at rest, 24 to 45 px from the middle."""

    def perturb(frames: Frames, generator: np.random.Generator) -> Frames:
        angle, away = generator.uniform(0, 2 * np.pi), generator.uniform(24, 45)
        x, y = MIDDLE + away * np.cos(angle), MIDDLE + away * np.sin(angle)
        rows, columns = np.indices(frames.shape[1:3]) + 0.5
        cover = np.clip(6 - np.hypot(columns - x, rows - y) + 0.5, 0, 1)[..., None]
        light = np.clip(1 - np.hypot(columns - x + 2, rows - y + 2) / 14, 0.3, 1)[..., None]
        return (frames * (1 - cover) + cover * light * np.array(color)).round().astype(np.uint8)

    return perturb


def _hand(frames: Frames, generator: np.random.Generator) -> Frames:
    """Add a still hand at a side of the frame."""
    made = np.rot90(frames, side := int(generator.integers(4)), axes=(1, 2)).copy()
    at = int(generator.uniform(20, 108))
    for frame in made:
        cv2.ellipse(frame, (at, 0), (16, 24), 0, 0, 360, (196, 150, 120), -1, cv2.LINE_AA)
        for finger in range(4):
            start, end = (at - 12 + 8 * finger, 15), (at - 14 + 9 * finger, 34)
            cv2.line(frame, start, end, (190, 142, 112), 6, cv2.LINE_AA)
    return np.ascontiguousarray(np.rot90(made, -side, axes=(1, 2)))


def _shake(reach: float) -> Perturb:
    """Return a perturbation that shifts every frame but the last by up to ``reach`` px."""

    def perturb(frames: Frames, generator: np.random.Generator) -> Frames:
        shifts = generator.uniform(-reach, reach, (len(frames), 2))
        shifts[-1] = 0
        return np.stack([_warped(f, np.eye(2), s) for f, s in zip(frames, shifts, strict=True)])

    return perturb


def _scale(factor: float) -> Perturbation:
    def perturb(frames: Frames, _: np.random.Generator) -> Frames:
        shift = np.full(2, MIDDLE * (1 - factor))
        return np.stack([_warped(frame, factor * np.eye(2), shift) for frame in frames])

    return Perturbation(
        f"scale {factor:g}", perturb, lambda places: MIDDLE + factor * (places - MIDDLE)
    )


def _warped(frame: np.ndarray, matrix: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Move the points p of a frame to matrix p + shift; pixel centres lie at halves."""
    half = np.full(2, 0.5)
    offset = matrix @ half + shift - half
    moved = np.column_stack([matrix, offset])
    size = (NETWORK_FRAME_SIZE, NETWORK_FRAME_SIZE)
    border = cv2.BORDER_REPLICATE
    return cv2.warpAffine(frame, moved, size, flags=cv2.INTER_LINEAR, borderMode=border)


def _noise(sigma: float) -> Perturb:
    def perturb(frames: Frames, generator: np.random.Generator) -> Frames:
        return (frames + generator.normal(0, sigma, frames.shape)).clip(0, 255).astype(np.uint8)

    return perturb


def _coded(kind: str, quality: int) -> Perturb:
    def perturb(frames: Frames, _: np.random.Generator) -> Frames:
        decoded: list[np.ndarray] = []
        for frame in frames:
            file = io.BytesIO()
            Image.fromarray(frame).save(file, kind, quality=quality)
            decoded.append(np.asarray(Image.open(file).convert("RGB")))
        return np.stack(decoded)

    return perturb


def _blur(sigma: float) -> Perturb:
    def perturb(frames: Frames, _: np.random.Generator) -> Frames:
        return np.stack([cv2.GaussianBlur(frame, (0, 0), sigma) for frame in frames])

    return perturb


def _hue(degrees: float) -> Perturb:
    def perturb(frames: Frames, _: np.random.Generator) -> Frames:
        turned = [cv2.cvtColor(frame, cv2.COLOR_RGB2HSV) for frame in frames]
        for frame in turned:
            frame[..., 0] = (frame[..., 0].astype(int) + int(degrees / 2)) % 180
        return np.stack([cv2.cvtColor(frame, cv2.COLOR_HSV2RGB) for frame in turned])

    return perturb


def _webcam(frames: Frames, generator: np.random.Generator) -> Frames:
    """Blur, warm light, another gamma, noise and JPEG at once."""
    warm = _pixelwise(lambda c: (c * np.array([1.1, 1, 0.85])).clip(0, 1) ** 0.85)
    for change in (_blur(0.7), warm, _noise(4), _coded("JPEG", 75)):
        frames = change(frames, generator)
    return frames


PERTURBATIONS: Sequence[Perturbation] = (
    Perturbation("none", lambda frames, _: frames),
    Perturbation("second ball at rest, green", _disc((40, 200, 60))),
    Perturbation("second ball at rest, red", _disc((220, 40, 40))),
    Perturbation("hand at a side, still", _hand),
    Perturbation("shake up to 0.5 px", _shake(0.5)),
    Perturbation("shake up to 1 px", _shake(1.0)),
    Perturbation("noise, sigma 5", _noise(5)),
    Perturbation("noise, sigma 10", _noise(10)),
    Perturbation("noise, sigma 15", _noise(15)),
    Perturbation("warm, R x 1.2, B x 0.7", _pixelwise(lambda c: c * np.array([1.2, 1, 0.7]))),
    Perturbation("cold, R x 0.7, B x 1.2", _pixelwise(lambda c: c * np.array([0.7, 1, 1.2]))),
    Perturbation("grayscale", _pixelwise(lambda c: np.repeat(c.mean(-1, keepdims=True), 3, -1))),
    Perturbation("contrast x 0.5", _pixelwise(lambda c: 0.5 + 0.5 * (c - 0.5))),
    Perturbation("gamma 0.6", _pixelwise(lambda c: c**0.6)),
    Perturbation("brightness + 40", _pixelwise(lambda c: c + 40 / 255)),
    _scale(0.75),
    _scale(0.9),
    _scale(1.1),
    Perturbation("webcam", _webcam),
    Perturbation("WebP, quality 30", _coded("WEBP", 30)),
    Perturbation("JPEG, quality 20", _coded("JPEG", 20)),
    Perturbation("blur, sigma 2", _blur(2)),
    Perturbation("hue turned by 60 degrees", _hue(60)),
)


@dataclass(frozen=True)
class PerturbationResult:
    """Forecasts of one scenario under one perturbation."""

    errors: np.ndarray
    """Error at T = 20, pixels of 128."""
    inside: np.ndarray
    """Coverage: the ellipse for 95 % contains the true position."""
    warned: np.ndarray
    """Presence of a warning about the frames or the ball."""


def outcome(
    service: Client, windows: Sequence[Window], perturbation: Perturbation, model: str
) -> PerturbationResult:
    """Forecast the perturbed windows of one ball."""
    rows: list[tuple[float, bool, bool]] = []
    for index, window in enumerate(windows):
        frames = window.frames[:OBSERVED_FRAMES]
        changed = perturbation.change(frames, np.random.default_rng(index))
        answer = service.predict(changed, horizon=HORIZON, num_objects=1, model=model)
        off = answer.positions[0, STEP] - perturbation.move(window.positions[0, STEP])
        spread = off @ np.linalg.pinv(answer.covariances[0, STEP]) @ off
        warned = bool(answer.warnings) or any(answer.object_warnings[0])
        rows.append((float(np.linalg.norm(off)), bool(spread <= CHI_SQUARED_95), warned))
    errors, inside, warned = (np.array(part) for part in zip(*rows, strict=True))
    return PerturbationResult(errors, inside, warned)


def measure(
    service: Client, sets: Sequence[EvaluationSet[Shown]], model: str
) -> Iterator[tuple[str, Mapping[Shown, PerturbationResult]]]:
    """Measure every perturbation; yields its name with the outcome of each scenario."""
    for one in PERTURBATIONS:
        yield (
            one.name,
            {part.scenario: outcome(service, part.windows, one, model) for part in sets},
        )


def results_table(measured: Sequence[tuple[str, Mapping[Shown, PerturbationResult]]]) -> str:
    """Return the table of a measurement, the unperturbed row first."""
    usual = {scenario: made.errors.mean() for scenario, made in measured[0][1].items()}
    rows: list[list[str]] = []
    for name, outcomes in measured:
        ratios = [made.errors.mean() / usual[scenario] for scenario, made in outcomes.items()]
        inside = np.concatenate([made.inside for made in outcomes.values()]).mean()
        warned = np.concatenate([made.warned for made in outcomes.values()]).mean()
        errors = [f"{made.errors.mean():.1f}" for made in outcomes.values()]
        rows.append(
            [name, *errors, f"{np.mean(ratios):.1f}", f"{100 * warned:.0f}", f"{100 * inside:.0f}"]
        )
    head = ["T=20, px", *usual, "ratio", "warned, %", "inside the 95 % ellipse, %"]
    return table(head, rows)
