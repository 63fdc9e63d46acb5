"""Exports the network for any number of balls as one artefact, and proves the export."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rollcast.ball_finding import by_motion, find_balls
from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import (
    CARD_FILE,
    GOLDEN_FILE,
    MANIFEST_FILE,
    CovarianceSource,
    KinematicSource,
    Manifest,
    MetricRow,
    Output,
    Parity,
    StateTensor,
)
from rollcast.outputs import SPECS, OutputName
from rollcast.scene import MAX_BALLS, Scenario
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES
from training.data.frame_spacing import SPACINGS_MS
from training.evaluation.any_ball import TorchFinder, forecast_sets
from training.evaluation.evaluate import EvaluationSet, markdown_table, metric_rows
from training.export.any_ball import OUTPUTS, STATE_NAMES, BallGraphs, write_ball_graphs
from training.export.export import evaluate, hashes, validated, with_covariance
from training.export.model_card import ARCHITECTURES
from training.export.spec import LICENCE
from training.export.weight_rounding import round_weights
from training.networks.any_ball import AnyBallNet
from training.networks.fieldnet import NUMBERS

GOLDEN_WINDOWS = 2
VALIDATED_NUMBERS = (1, 2, 5, MAX_BALLS)
"""Numbers of balls for which torch and ONNX Runtime are compared."""
VALIDATED_STEPS = 5
"""Steps up to which they are: prompts on nothing begin states whose rollouts magnify rounding. The
golden values prove one ball up to the trained horizon."""

LEVEL_SLOPE = 0.02
"""Slope between those estimated on tables and in bowls, see decision 0142."""

Sets = Mapping[int, Sequence[EvaluationSet[Scenario]]]
"""Evaluation sets by their number of balls."""


@dataclass(frozen=True)
class TrainedBalls:
    """Trained network with its metadata."""

    name: str
    network: AnyBallNet
    sequences: int
    """Training windows that its weights have seen."""
    horizon: int
    """Steps of the longest rollouts that trained its motion."""
    sources: Mapping[str, int]
    """Training scenes by kind."""
    seed: int


def export_balls(
    trained: TrainedBalls,
    folder: Path,
    version: int,
    validation: Sets,
    test: Sets,
    acceleration_ratio: float,
) -> Manifest:
    """Write ``models/NAME/VERSION`` and verify that its outputs equal those of torch.

    Parameters
    ----------
    validation, test
        Scenes that fit the covariances and choose models, and scenes that the card reports; of one
        ball at least.
    acceleration_ratio
        Of the kinematic forecasts (:mod:`training.export.kinematic_fit`).

    Raises
    ------
    ValueError
        When torch and ONNX Runtime differ by more than the tolerance.
    """
    folder.mkdir(parents=True, exist_ok=True)
    network = trained.network.cpu().eval()
    round_weights([network.perception])
    write_ball_graphs(network, folder)
    finder, graphs = TorchFinder(network), BallGraphs(folder)
    frames = [part.windows[0].frames for part in validation[1]]
    _write_golden(finder, frames[:GOLDEN_WINDOWS], trained.horizon, folder)
    parity = measure_ball_parity(finder, graphs, frames[0], min(trained.horizon, VALIDATED_STEPS))
    summary = evaluate(partial(forecast_sets, finder), validation[1], test[1], trained.horizon)
    several = {
        balls: _rows(finder, test[balls], summary.covariance, trained.horizon)
        for balls in sorted(test)
        if balls > 1
    }
    rows = [row for row in summary.rows if row.split == "test"]
    (folder / CARD_FILE).write_text(_card(trained, version, rows, several), encoding="utf-8")
    manifest = Manifest(
        format_version=3,
        name=trained.name,
        version=version,
        default=True,
        variant="fieldnet",
        preset="any-ball",
        scenarios=tuple(part.scenario for part in validation[1]),
        objects=1,
        max_objects=MAX_BALLS,
        observed_frames=OBSERVED_FRAMES,
        frames=OBSERVED_FRAMES,
        frame_rate_hz=FRAME_RATE_HZ,
        frame_rates_hz=(round(1000 / SPACINGS_MS[1], 1), 1000 / SPACINGS_MS[0]),
        frame_size=NETWORK_FRAME_SIZE,
        trained_horizon=trained.horizon,
        state=(
            StateTensor(name=STATE_NAMES[0], shape=(3, 32, 32)),
            StateTensor(name=STATE_NAMES[1], shape=(1, NUMBERS)),
        ),
        outputs=tuple(
            Output(name=name, shape=(1, *SPECS[name].shape), unit=SPECS[name].unit)
            for name in OUTPUTS
        ),
        covariance=summary.covariance,
        angular_velocity=True,
        kinematic=KinematicSource(acceleration_ratio=acceleration_ratio, level_slope=LEVEL_SLOPE),
        random_appearances=True,
        training={
            "sequences": trained.sequences,
            "seed": trained.seed,
            "interaction": True,
            "scenes": dict(trained.sources),
        },
        metrics=summary.rows,
        validation_error_px=summary.validation_error_px,
        parity=parity,
        golden_tolerance={name: SPECS[name].tolerance for name in OUTPUTS},
        files=hashes(folder),
        licence=LICENCE,
    )
    manifest.write(folder / MANIFEST_FILE)
    return manifest


def _rows(
    finder: TorchFinder,
    sets: Sequence[EvaluationSet[Scenario]],
    covariance: CovarianceSource,
    horizon: int,
) -> list[MetricRow]:
    made = with_covariance(forecast_sets(finder, sets), covariance)
    return metric_rows(sets, made, min(horizon, sets[0].horizon))


def _write_golden(
    finder: TorchFinder, frames: Sequence[np.ndarray], horizon: int, folder: Path
) -> None:
    """Write the golden values of torch for windows without prompts, one ball each."""
    rows: list[dict[str, np.ndarray]] = []
    for window in frames:
        balls, said = finder.find(window)
        rows.append(finder.forecast(balls.taken(by_motion(balls)[:1]), said, horizon))
    stacked = {name: np.stack([row[name] for row in rows]) for name in OUTPUTS}
    np.savez_compressed(
        folder / GOLDEN_FILE, allow_pickle=False, frames=np.stack(frames), **stacked
    )


def measure_ball_parity(
    finder: TorchFinder,
    graphs: BallGraphs,
    frames: np.ndarray,
    horizon: int,
    numbers: Sequence[int] = VALIDATED_NUMBERS,
) -> Parity:
    """Compare torch with ONNX Runtime for some numbers of balls, from the frames on.

    The prompts lie on a spiral over the frame, on balls and beside them: the comparison does
    not require a ball there.

    Raises
    ------
    ValueError
        When an output differs by more than its tolerance.
    """
    worst: dict[OutputName, float] = {}
    for number in numbers:
        turn, away = 2.4 * np.arange(number), 0.7 * np.sqrt((np.arange(number) + 0.5) / number)
        prompts = np.stack([away * np.cos(turn), away * np.sin(turn)], axis=-1)
        expected_balls, said = finder.find(frames, prompts)
        expected = finder.forecast(expected_balls, said, horizon)
        balls, said = find_balls(graphs.detect, graphs.refine, frames, prompts)
        for name, value in graphs.roll(balls, said, horizon).items():
            difference = float(np.abs(value - expected[name]).max())
            worst[name] = max(worst.get(name, 0.0), difference)
    return validated(worst)


def _card(
    trained: TrainedBalls,
    version: int,
    rows: Sequence[MetricRow],
    several: Mapping[int, Sequence[MetricRow]],
) -> str:
    sources = ", ".join(f"{count} {source}" for source, count in trained.sources.items())
    tables = "\n\n".join(
        f"### {balls} balls, test\n\n{markdown_table(found)}" for balls, found in several.items()
    )
    rates = f"{1000 / SPACINGS_MS[1]:.0f} to {1000 / SPACINGS_MS[0]:.0f} per second"
    return f"""# {trained.name}@{version}

FieldNet for 1 to {MAX_BALLS} balls, which point prompts may select. A detector finds the balls in
the frames at 128 x 128 pixels, and a refiner reads patches that are cut from the frames at their
full size. The motion was trained on rollouts of {trained.horizon} steps at {FRAME_RATE_HZ:g} Hz,
from frames of {rates}; the frame rate is an input of the model.

- Architecture: {ARCHITECTURES["field"]}, after a detector and a
  patch refiner. Supervision: positions, visibility, radii, angular velocities, ground maps,
  heights, 3-D velocities.
- Trained on {trained.sequences:,} windows of simulated scenes ({sources}), as they are and with
  random appearances, and of planar scenes with up to {MAX_BALLS} balls.
- Uncertainty: predicted by the network, times a scale per step fitted on validation scenes.
- Limits: the motion is learned from bowls and heightfields, and beyond step {trained.horizon} the
  network extrapolates.
- Licence: {LICENCE}.

## Measured

Errors are in pixels of 128 x 128 frames, the mean over test scenes from the fixed test start. The
model receives no prompts and no number of balls: the balls with the highest confidence of motion
are compared with the true balls nearest to them at t = 0. T is the horizon, so the error is that of
step T - 1.

### 1 ball, test

{markdown_table(rows)}

{tables}
"""
