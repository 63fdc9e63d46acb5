"""A second version of a model whose perception convolves in 8 bits: faster, a little less exact.

Static quantisation (decision 0021). Nothing is trained: the ranges of the activations are those
that validation frames reach.
"""

import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import onnx

from rollcast.manifest import (
    CARD_FILE,
    ENCODER_FILE,
    FRAMES_INPUT,
    GOLDEN_FILE,
    MANIFEST_FILE,
    OOD_FILE,
    PERCEPTION_FILE,
    ROLLOUT_FILE,
    Manifest,
    Parity,
)
from rollcast.outputs import SPECS, OutputName
from rollcast.scene import Scenario
from training.common.run_folder import current_name
from training.common.settings import keep_runtime_silent
from training.data.windows import collate, compared_horizon
from training.evaluation.evaluate import EvaluationSet, evaluation_sets, markdown_table
from training.export.export import EvaluationSummary, evaluate, hashes
from training.export.model_card import ARCHITECTURES
from training.export.onnx_graphs import Graphs, drop_traces
from training.export.weight_rounding import store_in_bytes
from training.objectives.metrics import Forecasts, beside_truth

KEPT_IN_FLOAT = ("perception.first.where.", "perception.first.ground.")
"""Prefixes of output convolutions, whose rounding has the largest effect."""

LEAST_GAIN = 1.5
MOST_LOSS_PX = 0.2
VALIDATION_SCENES = 100
CALIBRATION_WINDOWS = 20
"""Calibration windows of every scenario."""
BATCH = 50
TIMED_FORECASTS = 40


class NotWorthItError(Exception):
    """A quantised model is too slow or too inexact to be a version of its own."""


def quantise(source: Path, version: int, test_scenes: int, workers: int) -> Manifest:
    """Write another version of ``models/NAME/VERSION`` beside it, which is never the default.

    Raises
    ------
    FileNotFoundError
        When there is no such model, or it has no perception graph.
    NotWorthItError
        When it is not LEAST_GAIN times as fast, or errs by more than MOST_LOSS_PX more.
    """
    float32 = Manifest.read(source / MANIFEST_FILE)
    horizon = compared_horizon(float32.objects)
    sets_of = partial(
        evaluation_sets, float32.simulated, float32.objects, float32.final_step, workers=workers
    )
    validation = sets_of("validation", VALIDATION_SCENES)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_quantised(
            source / PERCEPTION_FILE, folder / PERCEPTION_FILE, _calibration_frames(validation)
        )
        known = () if float32.ood is None else (OOD_FILE,)
        for file in (ENCODER_FILE, ROLLOUT_FILE, *known):
            shutil.copy(source / file, folder / file)
        slow, fast = Graphs(source), Graphs(folder)
        gain = _gain(slow, fast, validation[0], horizon)
        test = sets_of("test", test_scenes)
        summary = evaluate(partial(_forecasts, fast), validation, test, float32.trained_horizon)
        loss = {
            row.scenario: row.position_error_px - before.position_error_px
            for row, before in zip(summary.rows, float32.metrics, strict=True)
            if (row.split, row.horizon) == ("validation", horizon)
        }
        changes = ", ".join(f"{change:+.2f} px ({scenario})" for scenario, change in loss.items())
        comparison = (
            f"{gain:.2f} times as fast up to T={horizon}, with an error change of {changes}"
        )
        if gain < LEAST_GAIN or max(loss.values()) > MOST_LOSS_PX:
            raise NotWorthItError(f"{float32.label} in 8 bits: {comparison}; nothing is written")
        parity = _write_golden(fast, source / GOLDEN_FILE, folder / GOLDEN_FILE, horizon)
        card = _card(float32, version, comparison, summary)
        (folder / CARD_FILE).write_text(card, encoding="utf-8")
        changed = {
            "version": version,
            "default": False,
            "covariance": summary.covariance,
            "metrics": summary.rows,
            "validation_error_px": summary.validation_error_px,
            "training": float32.training | {"quantised": f"{float32.label}: {comparison}"},
            "parity": parity,
            "golden_tolerance": {
                name: SPECS[name].quantised_tolerance for name in float32.output_names
            },
            "files": hashes(folder),
        }
        manifest = Manifest.model_validate(dict(float32) | changed)
        manifest.write(folder / MANIFEST_FILE)
        shutil.copytree(folder, source.parent / str(version), dirs_exist_ok=True)
    return manifest


def write_quantised(source: Path, to: Path, frames: np.ndarray) -> None:
    """Write a graph whose convolutions compute in 8 bits, but for KEPT_IN_FLOAT.

    Parameters
    ----------
    frames
        [B, K, 128, 128, 3], on which the ranges of the activations are measured.
    """
    keep_runtime_silent()
    from onnxruntime.quantization import (
        CalibrationDataReader,
        QuantFormat,
        QuantType,
        quant_pre_process,
        quantize_static,
    )

    class Frames(CalibrationDataReader):
        def __init__(self) -> None:
            self._rows = iter(frames)

        # None ends it, which its base's annotation leaves out.
        def get_next(self) -> dict[str, np.ndarray] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
            row = next(self._rows, None)
            return None if row is None else {FRAMES_INPUT: row[None]}

    with tempfile.TemporaryDirectory() as temporary:
        # 8-bit weights and their dequantisation (decision 0017) are folded into constants.
        folded = Path(temporary) / source.name
        quant_pre_process(source, folded, skip_symbolic_shape=True)
        nodes = onnx.load(folded).graph.node
        kept = [
            node.name
            for node in nodes
            if node.op_type == "Conv" and current_name(node.input[1]).startswith(KEPT_IN_FLOAT)
        ]
        # Weights in 7 bits: two products of 8 overflow where a processor adds them in 16 bits.
        quantize_static(
            folded, to, Frames(), quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv"], nodes_to_exclude=kept, per_channel=True,
            activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
            reduce_range=True,
        )  # fmt: skip
    model = onnx.load(to)
    store_in_bytes(model.graph)
    drop_traces(model.graph)
    onnx.checker.check_model(model)
    onnx.save(model, to)


def _calibration_frames(sets: Sequence[EvaluationSet[Scenario]]) -> np.ndarray:
    windows = [window for part in sets for window in part.windows[:CALIBRATION_WINDOWS]]
    return collate(windows)["frames"].numpy()


def _forecasts(
    graphs: Graphs, sets: Sequence[EvaluationSet[Scenario]]
) -> Mapping[Scenario, Forecasts]:
    """Forecast every set up to T_gen."""
    made: dict[Scenario, Forecasts] = {}
    for part in sets:
        batches = [part.windows[k : k + BATCH] for k in range(0, len(part.windows), BATCH)]
        rolled = [graphs.roll(collate(b)["frames"].numpy(), part.horizon) for b in batches]
        outputs = {name: np.concatenate([batch[name] for batch in rolled]) for name in rolled[0]}
        made[part.scenario] = beside_truth(
            part.windows,
            outputs["positions"],
            outputs.get("covariances"),
            outputs.get("angular_velocities"),
        )
    return made


def _gain(slow: Graphs, fast: Graphs, part: EvaluationSet[Scenario], horizon: int) -> float:
    """Speed-up of a single forecast on one thread: ratio of medians, measured in turns."""
    durations: dict[Graphs, list[float]] = {slow: [], fast: []}
    for window in part.windows[:TIMED_FORECASTS]:
        frames = collate([window])["frames"].numpy()
        for graphs, seconds in durations.items():
            began = time.perf_counter()
            graphs.roll(frames, horizon)
            seconds.append(time.perf_counter() - began)
    return float(np.median(durations[slow]) / np.median(durations[fast]))


def _write_golden(graphs: Graphs, source: Path, to: Path, horizon: int) -> Parity:
    """Store the graphs' outputs for the golden frames; return the differences from torch.

    Raises
    ------
    NotWorthItError
        If a difference exceeds the output's tolerance.
    """
    with np.load(source) as golden:
        frames = golden[FRAMES_INPUT]
        torchs = {name: golden[name] for name in golden.files if name != FRAMES_INPUT}
    outputs = graphs.roll(frames, horizon)
    off: dict[OutputName, float] = {
        name: float(np.abs(value - torchs[name][:, :, : value.shape[2]]).max())
        for name, value in outputs.items()
    }
    for name, difference in off.items():
        tolerance = SPECS[name].quantised_tolerance
        if difference > tolerance:
            raise NotWorthItError(f"{name}: {difference} different from torch, over {tolerance}")
    np.savez_compressed(to, allow_pickle=False, frames=frames, **outputs)
    return Parity(
        max_abs_error=off, tolerance={name: SPECS[name].quantised_tolerance for name in off}
    )


def _card(float32: Manifest, version: int, comparison: str, summary: EvaluationSummary) -> str:
    """Model card in Markdown."""
    return f"""# {float32.name}@{version}

{float32.label} with the convolutions of its perception in 8 bits: {comparison}.
Measured on {VALIDATION_SCENES} validation scenes per scenario, on one thread of a processor with
8-bit dot product instructions; without them the speed-up is smaller. The training, the limits and
the licence in the card of {float32.label} apply to this version too.

- Architecture: {ARCHITECTURES[float32.preset]},
  with 8-bit convolutions in its perception. Supervision: none; {float32.label} was quantised.

## Measured

Errors in pixels of 128 x 128 frames, as in the card of {float32.label}, with the graphs of this
version.

### Test

{markdown_table([row for row in summary.rows if row.split == "test"])}

### Validation

{markdown_table([row for row in summary.rows if row.split == "validation"])}
"""
