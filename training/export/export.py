"""Exports a trained network as the artefact that the service loads, and proves the export."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import (
    BALL_FILES,
    CARD_FILE,
    GOLDEN_FILE,
    MANIFEST_FILE,
    OOD_FILE,
    PERCEPTION_FILE,
    CovarianceSource,
    Manifest,
    MetricRow,
    Output,
    Parity,
    StateTensor,
    gaussian_radius,
)
from rollcast.outputs import SPECS, OutputName
from rollcast.trajectory import OBSERVED_FRAMES
from training.common.run_folder import read_best
from training.data.windows import Window, collate
from training.evaluation.evaluate import EvaluationSet, Shown, evaluation_sets, metric_rows, run
from training.export.model_card import model_card
from training.export.onnx_graphs import (
    STATE_NAMES,
    Graphs,
    first_observation,
    present,
    write_graphs,
)
from training.export.spec import Trained
from training.export.weight_rounding import round_weights
from training.networks.perception import Perception
from training.networks.perception_state import AttendedTransition
from training.networks.recurrent import Network
from training.objectives.metrics import HALF, Forecasts, distances_sigmas
from training.recipes.recipe import Recipe

Key = TypeVar("Key")

GOLDEN_SEQUENCES = 2
CALIBRATED = (0.50, 0.95)


def export_run(
    recipe: Recipe, folder: Path, models: Path, version: int, test_scenes: int, workers: int
) -> list[Manifest]:
    """Export every member of a recipe with the best weights of its run.

    Raises
    ------
    FileNotFoundError
        When the run has no weights yet.
    ValueError
        When torch and ONNX Runtime differ by more than the tolerance.
    """
    best = read_best(folder)
    kind = (recipe.scenarios, recipe.task.objects, recipe.task.final_step)
    validation = evaluation_sets(*kind, "validation", recipe.validation_scenes, workers)
    test = evaluation_sets(*kind, "test", test_scenes, workers)
    manifests: list[Manifest] = []
    for name, predictor in recipe.build().networks().items():
        predictor.load_state_dict(best["weights"][name])
        trained = Trained(recipe, name, predictor, best["sequences"], best["horizon"])
        to = models / name / str(version)
        manifests.append(export(trained, to, version, validation, test))
    return manifests


def export(
    trained: Trained,
    folder: Path,
    version: int,
    validation: Sequence[EvaluationSet[Shown]],
    test: Sequence[EvaluationSet[Shown]],
) -> Manifest:
    """Write ``models/NAME/VERSION`` and verify that its outputs equal those of torch.

    Parameters
    ----------
    validation, test
        Scenes that fit the covariances and choose models, and scenes that the card reports.

    Raises
    ------
    ValueError
        When torch and ONNX Runtime differ by more than the tolerance.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The file of an earlier export; training.export.ood_fit writes a new one.
    (folder / OOD_FILE).unlink(missing_ok=True)
    task = trained.recipe.task
    predictor = trained.predictor.cpu().eval()
    round_weights(m for m in predictor.modules() if isinstance(m, Perception | AttendedTransition))
    sample = collate(_spread(validation, GOLDEN_SEQUENCES))["frames"]
    write_graphs(predictor, sample, folder)
    horizon = trained.horizon
    _write_golden(predictor, sample, horizon, folder)
    windows = _spread(validation, 3)
    # Not beyond the trained horizon: there a rollout may magnify any rounding.
    parity = measure_parity(predictor, folder, windows, horizons=(max(horizon // 2, 1), horizon))
    summary = evaluate(partial(run, predictor), validation, test, horizon)
    observation = first_observation(predictor, sample)
    card = model_card(trained, version, summary.rows, summary.covariance)
    (folder / CARD_FILE).write_text(card, encoding="utf-8")
    manifest = Manifest(
        format_version=3,
        name=trained.name,
        version=version,
        default=True,
        variant=trained.recipe.member(trained.name).variant,
        preset=trained.recipe.preset,
        scenarios=trained.scenarios,
        objects=task.objects,
        observed_frames=OBSERVED_FRAMES,
        frames=task.frames,
        final_step=task.final_step,
        frame_rate_hz=trained.frame_rate_hz,
        frame_size=NETWORK_FRAME_SIZE,
        trained_horizon=horizon,
        state=tuple(
            StateTensor(name=name, shape=tuple(tensor.shape[1:]))
            for name, tensor in zip(STATE_NAMES, predictor.start(sample), strict=True)
        ),
        outputs=tuple(
            Output(name=name, shape=(task.objects, *SPECS[name].shape), unit=SPECS[name].unit)
            for name in observation
        ),
        covariance=summary.covariance,
        angular_velocity="angular_velocities" in observation,
        training={
            "sequences": trained.sequences,
            "seed": trained.recipe.seed,
            "interaction": task.interaction,
            "scenes" if trained.filmed is None else "clips": {**trained.sources},
        },
        setup=None if trained.filmed is None else trained.filmed.setup,
        metrics=summary.rows,
        validation_error_px=summary.validation_error_px,
        parity=parity,
        golden_tolerance={name: SPECS[name].tolerance for name in observation},
        files=hashes(folder),
        licence=trained.licence,
    )
    manifest.write(folder / MANIFEST_FILE)
    return manifest


@dataclass(frozen=True)
class EvaluationSummary:
    """Accuracy and covariances of a model's forecasts, for its manifest."""

    covariance: CovarianceSource
    rows: tuple[MetricRow, ...]
    validation_error_px: float


def evaluate(
    forecast: Callable[[Sequence[EvaluationSet[Shown]]], Mapping[Shown, Forecasts]],
    validation: Sequence[EvaluationSet[Shown]],
    test: Sequence[EvaluationSet[Shown]],
    horizon: int,
) -> EvaluationSummary:
    """Fit a model's covariances on the validation split, and measure it on both.

    Parameters
    ----------
    forecast
        The model: forecasts every set up to T_gen.
    horizon
        Its trained horizon.
    """
    on_validation = forecast(validation)
    covariance = fit_covariance(on_validation)
    rows = metric_rows(validation, with_covariance(on_validation, covariance), horizon)
    rows += metric_rows(test, with_covariance(forecast(test), covariance), horizon)
    compared = validation[0].horizon // 2
    errors = [
        row.position_error_px
        for row in rows
        if row.split == "validation" and row.horizon == compared
    ]
    return EvaluationSummary(covariance, tuple(rows), round(float(np.mean(errors)), 4))


def _spread(sets: Sequence[EvaluationSet[Shown]], windows: int) -> list[Window]:
    """Take some windows, from every scenario in turn."""
    return [sets[k % len(sets)].windows[k // len(sets)] for k in range(windows)]


def _write_golden(predictor: Network, frames: Tensor, horizon: int, folder: Path) -> None:
    with torch.inference_mode():
        rollout = predictor(frames, horizon)
    values = zip(first_observation(predictor, frames), present(rollout), strict=True)
    arrays: dict[str, np.ndarray] = {name: value.numpy() for name, value in values}
    np.savez_compressed(folder / GOLDEN_FILE, allow_pickle=False, frames=frames.numpy(), **arrays)


def measure_parity(
    predictor: Network, folder: Path, windows: Sequence[Window], horizons: Sequence[int]
) -> Parity:
    """Compare torch with ONNX Runtime at batch sizes 1 and ``len(windows)`` and some horizons.

    Raises
    ------
    ValueError
        When an output differs by more than its tolerance.
    """
    frames = collate(windows)["frames"]
    worst: dict[OutputName, float] = {}
    graphs = Graphs(folder)
    for batch in (frames[:1], frames):
        for horizon in horizons:
            with torch.inference_mode():
                expected = present(predictor(batch, horizon))
            rolled = graphs.roll(batch.numpy(), horizon)
            for (name, value), truth in zip(rolled.items(), expected, strict=True):
                difference = float(np.abs(value - truth.numpy()).max())
                worst[name] = max(worst.get(name, 0.0), difference)
    return validated(worst)


def validated(worst: Mapping[OutputName, float]) -> Parity:
    """Return the proof of an export whose outputs differ at most so much from torch's.

    Raises
    ------
    ValueError
        When an output differs by more than its tolerance.
    """
    for name, difference in worst.items():
        tolerance = SPECS[name].tolerance
        if not difference <= tolerance:
            raise ValueError(f"{name}: torch and ONNX differ by {difference}, over {tolerance}")
    return Parity(
        max_abs_error={name: float(f"{value:.2e}") for name, value in worst.items()},
        tolerance={name: SPECS[name].tolerance for name in worst},
    )


def fit_covariance(forecasts: Mapping[Key, Forecasts]) -> CovarianceSource:
    """Fit the covariances of the manifest on validation forecasts up to T_gen.

    A network that predicts covariances gets a variance scale at every step: the largest of those
    with which its ellipses of CALIBRATED shares hold as many truths, since too sure is worse than
    too unsure. The scale of highest likelihood would follow the few forecasts that are far off.
    Any other network gets the covariance of its own residuals. As far as half of the truths reach
    then is the radius of the ellipse that should hold half of them: where tails are heavier than a
    Gaussian's, no scale fits both shares.
    """
    residuals = np.concatenate([f.true_positions - f.positions for f in forecasts.values()])
    residuals = residuals.reshape(-1, residuals.shape[-2], 2).astype(float)
    covariances = [f.covariances for f in forecasts.values() if f.covariances is not None]
    if not covariances:
        moments = np.einsum("nti,ntj->tij", residuals, residuals) / len(residuals)
        return CovarianceSource(
            source="empirical",
            empirical=tuple(
                ((round(m[0][0], 4), round(m[0][1], 4)), (round(m[1][0], 4), round(m[1][1], 4)))
                for m in moments.tolist()
            ),
            ellipse50_radius=_ellipse50_radii(distances_sigmas(residuals, moments)),
        )
    joined = np.concatenate(covariances).reshape(-1, residuals.shape[1], 2, 2)
    distances = distances_sigmas(residuals, joined.astype(float))
    scale = np.max(
        [(np.quantile(distances, p, axis=0) / gaussian_radius(p)) ** 2 for p in CALIBRATED], axis=0
    )
    return CovarianceSource(
        source="predicted",
        variance_scale=tuple(round(value, 4) for value in scale.tolist()),
        ellipse50_radius=_ellipse50_radii(distances / np.sqrt(scale)),
    )


def _ellipse50_radii(distances: np.ndarray) -> tuple[float, ...]:
    """Radius at every step that holds half of the distances [residuals, steps]."""
    return tuple(round(value, 4) for value in np.quantile(distances, HALF, axis=0).tolist())


def with_covariance(
    forecasts: Mapping[Key, Forecasts], covariance: CovarianceSource
) -> Mapping[Key, Forecasts]:
    """Forecasts with the covariances that the service will answer with.

    Their horizon may be shorter than that of the fitted covariances.
    """
    return {
        scenario: replace(
            made,
            covariances=_served_covariances(made, covariance),
            ellipse50_radii=None
            if covariance.ellipse50_radius is None
            else np.array(covariance.ellipse50_radius)[: made.positions.shape[2]],
        )
        for scenario, made in forecasts.items()
    }


def _served_covariances(made: Forecasts, covariance: CovarianceSource) -> np.ndarray:
    steps = made.positions.shape[2]
    if covariance.empirical is not None:
        by_step = np.array(covariance.empirical, dtype=np.float32)[:steps]
        return np.tile(by_step, (*made.positions.shape[:2], 1, 1, 1))
    assert made.covariances is not None
    assert covariance.variance_scale is not None
    scale = np.array(covariance.variance_scale, dtype=np.float32)[:steps]
    return made.covariances * scale[:, None, None]


def hashes(folder: Path) -> dict[str, str]:
    """Sha256 of an artefact's files, by name."""
    possible = (PERCEPTION_FILE, OOD_FILE, *BALL_FILES)
    there = [name for name in possible if (folder / name).exists()]
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in there}
