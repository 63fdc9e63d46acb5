"""Exports a trained network as the artefact that the service loads, and proves the export.

Torch's parameters keep their names as initialisers, so the committed artefact is also what later
training starts from.
"""

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import (
    CARD_FILE,
    ENCODER_FILE,
    FRAMES_INPUT,
    GOLDEN_FILE,
    HASHED_FILES,
    MANIFEST_FILE,
    NEXT_PREFIX,
    OUTPUT_SHAPES,
    STEP_FILE,
    CovarianceSource,
    Manifest,
    Output,
    OutputName,
    Parity,
    StateTensor,
)
from rollcast.scene import Scenario
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES
from training.card import LICENCE, model_card
from training.dataset import Window, collate, compared_horizon
from training.evaluate import EvaluationSet, evaluation_sets, metric_rows, run
from training.metrics import Forecasts
from training.models.eye import Eye
from training.models.predictor import Network, Observation, State
from training.models.sighted import AttendedTransition
from training.recipes.recipe import Recipe
from training.settings import keep_runtime_silent
from training.storage import rename, round_weights, store_in_bytes
from training.trainer import BEST

STATE_NAMES = State._fields
TOLERANCE: Mapping[OutputName, float] = {
    "positions": 1e-2,
    "covariances": 5e-2,
    "angular_velocities": 5e-2,
    "final_positions": 1e-2,
}
"""px, px^2 and rad/s: the largest difference between torch and ONNX Runtime that passes."""

UNITS: Mapping[OutputName, str] = {
    "positions": "px",
    "covariances": "px^2",
    "angular_velocities": "rad/s",
    "final_positions": "px",
}
GOLDEN_SEQUENCES = 2
CALIBRATED = (0.50, 0.95)
_OWN_PREFIX = "network."


class EncoderGraph(torch.nn.Module):
    """The encoder's graph."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, frames: Tensor) -> tuple[Tensor, ...]:
        """Frames to the state and the first observation, as positional tensors."""
        state = self.network.start(frames)
        return *state, *_present(self.network.observe_first(state))


class StepGraph(torch.nn.Module):
    """The step's graph."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, s: Tensor, p: Tensor) -> tuple[Tensor, ...]:
        """State to the next state and its observation, as positional tensors."""
        state = self.network.advance(State(s, p))
        return *state, *_present(self.network.observe(state))


@dataclass(frozen=True)
class Trained:
    """A network ready to be exported: the member ``name`` of a recipe."""

    recipe: Recipe
    name: str
    predictor: Network
    sequences: int
    """Training sequences that its weights have seen."""
    horizon: int
    """Steps of the longest rollouts that trained its weights."""


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
    best = torch.load(folder / BEST, map_location="cpu", weights_only=True)
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
    validation: Sequence[EvaluationSet],
    test: Sequence[EvaluationSet],
) -> Manifest:
    """Write ``models/NAME/VERSION`` and prove that it computes what torch does.

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
    task = trained.recipe.task
    predictor = trained.predictor.cpu().eval()
    round_weights(m for m in predictor.modules() if isinstance(m, Eye | AttendedTransition))
    sample = collate(_spread(validation, GOLDEN_SEQUENCES))["frames"]
    _write_graphs(predictor, sample, folder)
    horizon = trained.horizon
    _write_golden(predictor, sample, horizon, folder)
    windows = _spread(validation, 3)
    # Not beyond the trained horizon: there a rollout may magnify any rounding.
    parity = measure_parity(predictor, folder, windows, horizons=(max(horizon // 2, 1), horizon))
    on_validation = run(predictor, validation)
    covariance = fit_covariance(on_validation)
    rows = metric_rows(validation, with_covariance(on_validation, covariance), horizon)
    rows += metric_rows(test, with_covariance(run(predictor, test), covariance), horizon)
    chosen = [
        row.position_error_px
        for row in rows
        if row.split == "validation" and row.horizon == compared_horizon(task.objects)
    ]
    observation = _observation_of(predictor, sample)
    card = model_card(
        trained.recipe, trained.name, version, trained.sequences, horizon, rows, covariance
    )
    (folder / CARD_FILE).write_text(card, encoding="utf-8")
    manifest = Manifest(
        format_version=1,
        name=trained.name,
        version=version,
        default=True,
        variant=trained.recipe.member(trained.name).variant,
        preset=trained.recipe.preset,
        scenarios=trained.recipe.scenarios,
        objects=task.objects,
        observed_frames=OBSERVED_FRAMES,
        frames=task.frames,
        final_step=task.final_step,
        frame_rate_hz=FRAME_RATE_HZ,
        frame_size=NETWORK_FRAME_SIZE,
        trained_horizon=horizon,
        state=tuple(
            StateTensor(name=name, shape=tuple(tensor.shape[1:]))
            for name, tensor in zip(STATE_NAMES, predictor.start(sample), strict=True)
        ),
        outputs=tuple(
            Output(
                name=name,
                shape=(task.objects, *OUTPUT_SHAPES[name]),
                unit=UNITS[name],
            )
            for name in observation
        ),
        covariance=covariance,
        angular_velocity="angular_velocities" in observation,
        training={
            "sequences": trained.sequences,
            "seed": trained.recipe.seed,
            "interaction": task.interaction,
            "scenes": {part.source.name: part.scenes for part in trained.recipe.data},
        },
        metrics=tuple(rows),
        validation_error_px=round(float(np.mean(chosen)), 4),
        parity=parity,
        golden_tolerance={name: TOLERANCE[name] for name in observation},
        files={name: _sha256(folder / name) for name in HASHED_FILES},
        licence=LICENCE,
    )
    manifest.write(folder / MANIFEST_FILE)
    return manifest


def _present(observation: Observation) -> tuple[Tensor, ...]:
    outputs = observation._replace(reading=None)
    return tuple(part for part in outputs if isinstance(part, Tensor))


def _observation_of(predictor: Network, frames: Tensor) -> dict[OutputName, Tensor]:
    """First observation by output name, without what the network does not have."""
    with torch.inference_mode():
        observation = predictor.observe_first(predictor.start(frames))
    named: dict[OutputName, Tensor | None] = {
        "positions": observation.positions,
        "covariances": observation.covariances,
        "angular_velocities": observation.angular_velocities,
        "final_positions": observation.final_positions,
    }
    return {name: value for name, value in named.items() if value is not None}


def _of_a_step(outputs: Sequence[OutputName]) -> list[OutputName]:
    """Return the step graph's outputs: the final position is said by the encoder alone."""
    return [name for name in outputs if name != "final_positions"]


def _spread(sets: Sequence[EvaluationSet], windows: int) -> list[Window]:
    """Take some windows, from every scenario in turn."""
    return [sets[k % len(sets)].windows[k // len(sets)] for k in range(windows)]


def _write_graphs(predictor: Network, frames: Tensor, folder: Path) -> None:
    outputs = list(_observation_of(predictor, frames))
    batch = torch.export.Dim("batch", min=1, max=4096)
    with torch.inference_mode():
        state = predictor.start(frames)
    _write_graph(
        EncoderGraph(predictor), (frames,), [FRAMES_INPUT], [*STATE_NAMES, *outputs],
        {"frames": {0: batch}}, folder / ENCODER_FILE,
    )  # fmt: skip
    _write_graph(
        StepGraph(predictor), tuple(state), list(STATE_NAMES),
        [*(NEXT_PREFIX + name for name in STATE_NAMES), *_of_a_step(outputs)],
        {name: {0: batch} for name in STATE_NAMES}, folder / STEP_FILE,
    )  # fmt: skip


def _write_graph(
    module: torch.nn.Module,
    arguments: tuple[Tensor, ...],
    inputs: list[str],
    outputs: list[str],
    dynamic: dict[str, dict[int, object]],
    path: Path,
) -> None:
    # Ordinary tensors: those made in inference mode cannot be traced.
    arguments = tuple(argument.clone() for argument in arguments)
    with warnings.catch_warnings():
        # The state's tensors share the batch axis; torch warns that it keeps one name for it.
        warnings.filterwarnings("ignore", message="# The axis name")
        # torch's exporter calls what torch itself has deprecated.
        warnings.filterwarnings("ignore", message=".isinstance.treespec", category=FutureWarning)
        torch.onnx.export(
            module.eval(), arguments, path, input_names=inputs, output_names=outputs,
            dynamic_shapes=dynamic, dynamo=True, external_data=False, verbose=False,
        )  # fmt: skip
    model = onnx.load(path)
    for initialiser in model.graph.initializer:
        rename(model.graph, initialiser.name, initialiser.name.removeprefix(_OWN_PREFIX))
        initialiser.name = initialiser.name.removeprefix(_OWN_PREFIX)
    store_in_bytes(model.graph)
    drop_traces(model.graph)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def drop_traces(graph: onnx.GraphProto) -> None:
    """Drop the exporter's stack traces: paths of this machine, and other bytes in every export."""
    parts = (graph.node, graph.initializer, graph.value_info, graph.input, graph.output)
    for part in (graph, *(one for of_kind in parts for one in of_kind)):
        del part.metadata_props[:]
        part.doc_string = ""


def _write_golden(predictor: Network, frames: Tensor, horizon: int, folder: Path) -> None:
    with torch.inference_mode():
        rollout = predictor(frames, horizon)
    values = zip(_observation_of(predictor, frames), _present(rollout), strict=True)
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
    for batch in (frames[:1], frames):
        for horizon in horizons:
            with torch.inference_mode():
                expected = _present(predictor(batch, horizon))
            rolled = _roll_onnx(
                folder, batch.numpy(), horizon, list(_observation_of(predictor, batch))
            )
            for (name, value), truth in zip(rolled.items(), expected, strict=True):
                difference = float(np.abs(value - truth.numpy()).max())
                worst[name] = max(worst.get(name, 0.0), difference)
    for name, difference in worst.items():
        if not difference <= TOLERANCE[name]:
            raise ValueError(
                f"{name}: torch and ONNX differ by {difference}, over {TOLERANCE[name]}"
            )
    return Parity(
        max_abs_error={name: float(f"{value:.2e}") for name, value in worst.items()},
        tolerance={name: TOLERANCE[name] for name in worst},
    )


def _roll_onnx(
    folder: Path, frames: np.ndarray, horizon: int, outputs: list[OutputName]
) -> dict[OutputName, np.ndarray]:
    keep_runtime_silent()
    import onnxruntime

    encoder = onnxruntime.InferenceSession(folder / ENCODER_FILE)
    step = onnxruntime.InferenceSession(folder / STEP_FILE)
    values = encoder.run([*STATE_NAMES, *outputs], {FRAMES_INPUT: frames})
    state, first = values[: len(STATE_NAMES)], values[len(STATE_NAMES) :]
    rows: dict[OutputName, list[np.ndarray]] = {
        name: [value] for name, value in zip(outputs, first, strict=True)
    }
    stepped = _of_a_step(outputs)
    for _ in range(horizon - 1):
        values = step.run(
            [*(NEXT_PREFIX + name for name in STATE_NAMES), *stepped],
            dict(zip(STATE_NAMES, state, strict=True)),
        )
        state = values[: len(STATE_NAMES)]
        for name, value in zip(stepped, values[len(STATE_NAMES) :], strict=True):
            rows[name].append(value)
    return {
        name: np.stack(parts, axis=2) if name in stepped else parts[0]
        for name, parts in rows.items()
    }


def fit_covariance(forecasts: Mapping[Scenario, Forecasts]) -> CovarianceSource:
    """Fit what the manifest says of uncertainty, on validation forecasts up to T_gen.

    A network that predicts covariances gets a variance scale at every step: the largest of those
    with which its ellipses of CALIBRATED shares hold as many truths, since too sure is worse than
    too unsure. The scale of highest likelihood would follow the few forecasts that are far off.
    Any other network gets the covariance of its own residuals.
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
        )
    joined = np.concatenate(covariances).reshape(-1, residuals.shape[1], 2, 2)
    solved = np.linalg.solve(joined.astype(float), residuals[..., None])[..., 0]
    squared = np.sum(residuals * solved, axis=-1)
    # The squared radius of a bivariate Gaussian's ellipse that holds a share p: -2 ln(1 - p).
    fitting = [np.quantile(squared, p, axis=0) / (-2 * np.log(1 - p)) for p in CALIBRATED]
    scale = np.max(fitting, axis=0)
    return CovarianceSource(
        source="predicted", variance_scale=tuple(round(value, 4) for value in scale.tolist())
    )


def with_covariance(
    forecasts: Mapping[Scenario, Forecasts], covariance: CovarianceSource
) -> Mapping[Scenario, Forecasts]:
    """Forecasts with the covariances that the service will answer with."""
    return {
        scenario: replace(made, covariances=_served_covariances(made, covariance))
        for scenario, made in forecasts.items()
    }


def _served_covariances(made: Forecasts, covariance: CovarianceSource) -> np.ndarray:
    if covariance.empirical is not None:
        by_step = np.array(covariance.empirical, dtype=np.float32)
        return np.tile(by_step, (*made.positions.shape[:2], 1, 1, 1))
    assert made.covariances is not None
    assert covariance.variance_scale is not None
    scale = np.array(covariance.variance_scale, dtype=np.float32)
    return made.covariances * scale[:, None, None]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
