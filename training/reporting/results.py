"""Measures the committed models on the test set and keeps every figure in one file.

``docs/results/results.json`` holds the figures; ``docs/results.md`` and its pictures are made from
it (:mod:`training.reporting.markdown`, :mod:`training.reporting.plots`).
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from rollcast.manifest import MANIFEST_FILE, Manifest
from rollcast.scene import Scenario
from training.data.windows import generated_horizon
from training.evaluation.evaluate import (
    EvaluationSet,
    evaluation_sets,
    mean_error,
    measured_at,
    rounded,
    run,
)
from training.evaluation.paper import CONSTANT_POSITION, LINEAR_EXTRAPOLATION, published
from training.export.export import with_covariance
from training.export.load import load_exported
from training.objectives.metrics import Forecasts, constant_positions

LEVELS = tuple(round(0.05 * k, 2) for k in range(1, 20))
"""Nominal shares of truths inside an ellipse at which calibration is measured."""

MODELS = "models"
"""The table of the committed models."""

SetsOf: TypeAlias = Callable[
    [tuple[Scenario, ...], int, int | None], Sequence[EvaluationSet[Scenario]]
]
"""Gives the test sets of some scenarios, a number of balls and a final step."""


@dataclass(frozen=True)
class Measurement:
    """One figure of the tables: a method on one scenario at one moment.

    128-pixel units, rad/s, nats.

    Attributes
    ----------
    method
        Label of a model or name of a baseline.
    at
        "T=20", the error of step 19, or "worst step".
    paper_px
        The paper's cell for the same variant.
    study
        Which table it belongs to: MODELS, or a study's name.
    condition
        Condition of its scenes; "" for all scenes of the scenario.
    optimiser_steps, converged
        Of a row that the study trained: the steps of a training, and whether the validation error
        of all of them hardly fell over the last fifth; None where that was not tested.
    seeds
        Trainings that the figures are means of.
    seed_spread_px
        Largest minus smallest error of these trainings; None for one.
    """

    scenario: Scenario
    objects: int
    method: str
    variant: str
    at: str
    position_error_px: float
    standard_error_px: float
    test_sequences: int
    training_sequences: int | None = None
    angular_velocity_rmse: float | None = None
    nll_nats: float | None = None
    coverage_50: float | None = None
    coverage_95: float | None = None
    paper_px: float | None = None
    study: str = MODELS
    condition: str = ""
    optimiser_steps: int | None = None
    converged: bool | None = None
    seeds: int = 1
    seed_spread_px: float | None = None


@dataclass(frozen=True)
class Curve:
    """Error of a method over the steps, and how often its ellipses hold the truth.

    Attributes
    ----------
    quartiles_px
        Lower quartile, median and upper quartile at every step.
    coverage
        Share of truths inside the ellipse of each of LEVELS, over all steps up to T_train.
    study, condition
        Which table it belongs to, and which of the table's cases.
    """

    scenario: Scenario
    objects: int
    method: str
    trained_horizon: int | None = None
    quartiles_px: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] = ((), (), ())
    coverage: tuple[float, ...] | None = None
    study: str = MODELS
    condition: str = ""


@dataclass(frozen=True)
class Results:
    """Everything that was measured: the committed models' table, and the studies'."""

    cells: tuple[Measurement, ...]
    curves: tuple[Curve, ...]

    def of(self, study: str) -> "Results":
        """Return the figures of one table."""
        return Results(
            tuple(cell for cell in self.cells if cell.study == study),
            tuple(curve for curve in self.curves if curve.study == study),
        )

    def with_table(self, other: "Results") -> "Results":
        """Replace the committed models' table."""
        return Results(
            (*other.cells, *(cell for cell in self.cells if cell.study != MODELS)),
            (*other.curves, *(curve for curve in self.curves if curve.study != MODELS)),
        )

    def with_row(self, cells: Sequence[Measurement], curve: Curve) -> "Results":
        """Replace one method's figures on one case of a study, or add them."""
        row = _row(curve)
        return Results(
            (*(cell for cell in self.cells if _row(cell) != row), *cells),
            (*(known for known in self.curves if _row(known) != row), curve),
        )

    def write(self, path: Path) -> None:
        """Write a JSON file with a line a figure, so that versions can be compared."""
        parts = [
            f' "{name}": [\n  ' + ",\n  ".join(map(_line, items)) + "\n ]"
            for name, items in (("cells", self.cells), ("curves", self.curves))
        ]
        path.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> "Results":
        """Read a file of :meth:`write`."""
        stored = json.loads(path.read_text("utf-8"))
        return cls(
            tuple(Measurement(**cell) for cell in stored["cells"]),
            tuple(
                Curve(
                    **curve
                    | {
                        "quartiles_px": tuple(map(tuple, curve["quartiles_px"])),
                        "coverage": tuple(curve["coverage"]) if "coverage" in curve else None,
                    }
                )
                for curve in stored["curves"]
            ),
        )


def _line(figure: Measurement | Curve) -> str:
    """Return a figure as JSON, without unknown fields."""
    return json.dumps({name: part for name, part in asdict(figure).items() if part is not None})


def _row(figure: Measurement | Curve) -> tuple[str, str, int, str, str]:
    return figure.study, figure.scenario, figure.objects, figure.condition, figure.method


def committed(models: Path) -> list[Path]:
    """Folders of the default versions under ``models``, by name.

    Models for any number of balls are left out: their cards have their figures.
    """
    manifests = {path.parent: Manifest.read(path) for path in models.glob(f"*/*/{MANIFEST_FILE}")}
    return sorted(
        folder
        for folder, manifest in manifests.items()
        if manifest.default and manifest.max_objects is None
    )


def sets_of_test_split(scenes: int, workers: int) -> SetsOf:
    """Return a function that simulates (or loads) and renders the first test scenes once a kind."""
    return cache(partial(evaluation_sets, split="test", scenes=scenes, workers=workers))


def measure(models: Sequence[Path], sets_of: SetsOf) -> Results:
    """Measure models, and the baselines beside them."""
    cells: list[Measurement] = []
    curves: list[Curve] = []
    baselines: dict[tuple[Scenario, int], EvaluationSet[Scenario]] = {}
    for folder in models:
        manifest, predictor = load_exported(folder)
        sets = sets_of(manifest.simulated, manifest.objects, manifest.final_step)
        baselines |= {(part.scenario, manifest.objects): part for part in sets}
        forecasts = with_covariance(run(predictor, sets), manifest.covariance)
        made = [_measure_model(manifest, scenario, f) for scenario, f in forecasts.items()]
        cells += [cell for of_scenario, _ in made for cell in of_scenario]
        curves += [curve for _, curve in made]
    for (_, objects), part in baselines.items():
        for made in _measure_baselines(part, objects):
            cells += made[0]
            curves.append(made[1])
    return Results(tuple(cells), tuple(curves))


def _measure_model(
    manifest: Manifest, scenario: Scenario, forecasts: Forecasts
) -> tuple[list[Measurement], Curve]:
    errors = forecasts.errors_px()
    if manifest.final_step is not None:
        errors = errors[:, :, : manifest.final_step + 1]
    longest = generated_horizon(manifest.objects)
    horizons = {1, longest // 4, longest // 2, 3 * longest // 4, manifest.trained_horizon, longest}
    sequences = manifest.training["sequences"]
    assert isinstance(sequences, int)
    plain = Measurement(
        scenario=scenario,
        objects=manifest.objects,
        method=manifest.label,
        variant=manifest.variant,
        at="",
        position_error_px=0,
        standard_error_px=0,
        test_sequences=len(errors),
        training_sequences=sequences,
    )
    cells: list[Measurement] = []
    reached = sorted(horizon for horizon in horizons if horizon <= errors.shape[2])
    for horizon, measured in measured_at(forecasts, reached).items():
        at = f"T={horizon}"
        paper = published(scenario, manifest.objects, manifest.variant, at)
        paper_px = None if paper is None else paper.position_error_px
        cells.append(replace(plain, at=at, **measured._asdict(), paper_px=paper_px))
    worst = int(errors.mean(axis=(0, 1)).argmax())
    cells.append(_with_error(plain, "worst step", errors[:, :, worst]))
    inside = forecasts.calibration(LEVELS)
    trained = manifest.trained_horizon
    shares = None if inside is None else tuple(rounded(inside[k][:trained].mean()) for k in LEVELS)
    curve = curve_of(scenario, manifest.objects, manifest.label, trained, errors)
    return cells, replace(curve, coverage=shares)


def _measure_baselines(
    part: EvaluationSet[Scenario], objects: int
) -> list[tuple[list[Measurement], Curve]]:
    truth = np.stack([window.positions for window in part.windows])
    made: list[tuple[list[Measurement], Curve]] = []
    for method, positions in (
        (CONSTANT_POSITION, constant_positions(truth)),
        (LINEAR_EXTRAPOLATION, part.line),
    ):
        errors = np.linalg.norm(positions - truth, axis=-1)
        longest = errors.shape[2]
        cells: list[Measurement] = []
        for horizon in (1, longest // 4, longest // 2, 3 * longest // 4, longest):
            at = f"T={horizon}"
            paper = published(part.scenario, objects, method, at)
            plain = Measurement(part.scenario, objects, method, method, at, 0, 0, len(errors))
            cells.append(
                replace(
                    _with_error(plain, at, errors[:, :, horizon - 1]),
                    paper_px=None if paper is None else paper.position_error_px,
                )
            )
        made.append((cells, curve_of(part.scenario, objects, method, None, errors)))
    return made


def _with_error(cell: Measurement, at: str, errors: np.ndarray) -> Measurement:
    """Fill in a cell from the errors [sequences, objects] of one step."""
    error, spread = mean_error(errors)
    return replace(cell, at=at, position_error_px=error, standard_error_px=spread)


def curve_of(
    scenario: Scenario, objects: int, method: str, trained: int | None, errors: np.ndarray
) -> Curve:
    """Error over time from errors [sequences, objects, steps]."""
    low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75), axis=(0, 1)).round(3).tolist()
    return Curve(scenario, objects, method, trained, (tuple(low), tuple(middle), tuple(high)))


def disagreements(ours: Results, stored: Results) -> list[str]:
    """Describe every cell of the models' table that chance cannot explain beside the stored one.

    Both were measured on scenes of the same split, so they may differ by four standard errors of
    the smaller sample.
    """
    known: Mapping[tuple[str, int, str, str], Measurement] = {
        (cell.scenario, cell.objects, cell.method, cell.at): cell
        for cell in stored.of(MODELS).cells
    }
    found: list[str] = []
    for cell in ours.cells:
        name = (cell.scenario, cell.objects, cell.method, cell.at)
        other = known.get(name)
        if other is None:
            found.append(f"{name} is not in the stored results")
        elif cell.at != "worst step":
            difference = abs(cell.position_error_px - other.position_error_px)
            if difference > 4 * cell.standard_error_px + 0.02:
                found.append(
                    f"{name}: {cell.position_error_px} px now, {other.position_error_px} px stored"
                )
    return found
