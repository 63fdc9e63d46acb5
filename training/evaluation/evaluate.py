"""Measures forecasts on fixed scenes: per scenario and horizon, beside the trivial baselines."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.manifest import MetricRow
from rollcast.markdown import table
from rollcast.scene import Domain, Scenario
from rollcast.simulation.recording import TEST_START
from training.baselines.least_squares import POINTS, polynomial
from training.data.shards import Recording, Source, load_recordings, simulate_split
from training.data.splits import Split
from training.data.windows import Window, fixed_windows, generated_horizon
from training.networks.recurrent import Family, Network
from training.objectives.metrics import Forecasts, constant_positions, forecast

Shown = TypeVar("Shown", bound=Domain)
"""Domain of forecasts: scenarios, or footage."""


@dataclass(frozen=True)
class EvaluationSet(Generic[Shown]):
    """Fixed windows of one scenario, with the data of their recordings for the baselines."""

    scenario: Shown
    split: Split
    windows: Sequence[Window]
    line: np.ndarray
    """Forecast of the line through ten true positions [sequences, objects, T, 2]."""

    @property
    def objects(self) -> int:
        """Balls of every scene."""
        return self.line.shape[1]

    @property
    def horizon(self) -> int:
        """T_gen."""
        return self.line.shape[2]


def evaluation_sets(
    scenarios: Sequence[Scenario],
    objects: int,
    final_step: int | None,
    split: Split,
    scenes: int,
    workers: int,
) -> list[EvaluationSet[Scenario]]:
    """Simulate (or load) and render the first ``scenes`` scenes of a split of every scenario.

    Parameters
    ----------
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
    """
    horizon = generated_horizon(objects)
    sets: list[EvaluationSet[Scenario]] = []
    for scenario in scenarios:
        shards = simulate_split(Source(scenario, objects), split, scenes, workers)
        recordings = load_recordings(shards)
        history = np.stack([_first_positions(recording) for recording in recordings])
        windows = fixed_windows(recordings, horizon, final_step)
        sets.append(EvaluationSet(scenario, split, windows, polynomial(history, 1, horizon)))
    return sets


def _first_positions(recording: Recording) -> np.ndarray:
    """Return true image positions [objects, 10, 2] of t = -3..6."""
    scenario = recording.scene.scenario
    seen = recording.trajectory.window(TEST_START[scenario], POINTS)
    return camera_for(scenario, NETWORK_FRAME_SIZE).project(seen.positions_m).swapaxes(0, 1)


def run(predictor: Network, sets: Sequence[EvaluationSet[Shown]]) -> Mapping[Shown, Forecasts]:
    """Forecast every set up to T_gen."""
    device = next(predictor.parameters()).device
    alone = Family({"it": predictor})
    return {
        part.scenario: forecast(alone, part.windows, part.horizon, device)["it"] for part in sets
    }


class Measured(NamedTuple):
    """Measurements of forecasts at one step, rounded; None without such an output."""

    position_error_px: float
    standard_error_px: float
    angular_velocity_rmse: float | None
    nll_nats: float | None
    coverage_50: float | None
    coverage_95: float | None


def measured_at(made: Forecasts, horizons: Iterable[int]) -> dict[int, Measured]:
    """Measure forecasts at some horizons T: the error is that of step T - 1."""
    errors = made.errors_px()
    spin, nll = made.angular_velocity_rmse(), made.nll_nats()
    coverage = made.calibration((0.50, 0.95))
    return {
        horizon: Measured(
            *mean_error(errors[:, :, horizon - 1]),
            None if spin is None else rounded(spin[horizon - 1]),
            None if nll is None else rounded(nll[horizon - 1]),
            None if coverage is None else rounded(coverage[0.50][horizon - 1]),
            None if coverage is None else rounded(coverage[0.95][horizon - 1]),
        )
        for horizon in horizons
    }


def mean_error(errors: Float[np.ndarray, "sequences objects"]) -> tuple[float, float]:
    """Mean of one step's errors and its standard error; a sequence's balls are not independent."""
    by_sequence = errors.mean(axis=1)
    spread = by_sequence.std(ddof=1) / np.sqrt(len(by_sequence))
    return rounded(by_sequence.mean()), rounded(spread)


def metric_rows(
    sets: Sequence[EvaluationSet[Shown]],
    forecasts: Mapping[Shown, Forecasts],
    trained_horizon: int,
) -> list[MetricRow]:
    """Make the rows of a model's table, one a scenario and reported horizon."""
    rows: list[MetricRow] = []
    for part in sets:
        longest = part.horizon
        horizons = sorted({1, longest // 4, longest // 2, longest, trained_horizon})
        made = forecasts[part.scenario]
        truth = made.true_positions
        rest = np.linalg.norm(constant_positions(truth) - truth, axis=-1).mean(axis=(0, 1))
        line = np.linalg.norm(part.line - truth, axis=-1).mean(axis=(0, 1))
        for horizon, measured in measured_at(made, horizons).items():
            step = horizon - 1
            rows.append(
                MetricRow(
                    split="validation" if part.split == "validation" else "test",
                    scenario=part.scenario,
                    horizon=horizon,
                    sequences=len(truth),
                    **measured._asdict(),
                    constant_position_px=rounded(rest[step]),
                    linear_extrapolation_px=rounded(line[step]),
                )
            )
    return rows


def markdown_table(rows: Sequence[MetricRow]) -> str:
    """Rows as a Markdown table, baselines beside the forecasts."""
    head = (
        "scenario", "T", "sequences", "position error px", "ang. vel. RMSE rad/s",
        "neg. log likelihood", "in 50 %", "in 95 %", "constant position px",
            "linear extrapolation px",
    )  # fmt: skip
    return table(
        head,
        [(
            row.scenario, row.horizon, row.sequences,
            f"{row.position_error_px:.2f} ± {row.standard_error_px:.2f}",
            _cell(row.angular_velocity_rmse), _cell(row.nll_nats),
            _cell(row.coverage_50), _cell(row.coverage_95),
            _cell(row.constant_position_px), _cell(row.linear_extrapolation_px),
        ) for row in rows],
    )  # fmt: skip


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def rounded(value: float) -> float:
    """Round a figure as the files keep it."""
    return round(float(value), 4)
