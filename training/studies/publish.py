"""``evaluate --all``: measures the committed models and writes ``docs/results`` from it."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from rollcast.manifest import MANIFEST_FILE, Manifest
from training.data.windows import Window
from training.evaluation.evaluate import run
from training.export.export import with_covariance
from training.export.load import load_exported
from training.objectives.metrics import Forecasts
from training.reporting import plots
from training.reporting.markdown import page, picture_name
from training.reporting.results import Results, SetsOf, committed, measure, sets_of_test_split
from training.studies import tables
from training.studies.study import Study

DOCS = Path("docs")
"""Folder of the pages, relative to the working directory."""
RESULTS = "results.json"
STEPS_BETWEEN_ELLIPSES = 5


def publish(models: Path, docs: Path, scenes: int, workers: int) -> Results:
    """Write ``docs/results.md`` with ``docs/results/``: figures and pictures."""
    folders = committed(models)
    sets_of = sets_of_test_split(scenes, workers)
    results = measure(folders, sets_of)
    folder = docs / "results"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / RESULTS
    (Results.read(file).with_table(results) if file.exists() else results).write(file)
    (docs / "results.md").write_text(page(results, scenes), encoding="utf-8")
    groups = sorted(results.curves, key=lambda curve: (curve.objects, curve.scenario))
    for (objects, scenario), curves in groupby(groups, lambda c: (c.objects, c.scenario)):
        plots.draw_errors(list(curves), folder / picture_name(scenario, objects))
    plots.draw_calibration(results.curves, folder / "calibration.png")
    plots.draw_ellipses(
        _examples(folders, sets_of), STEPS_BETWEEN_ELLIPSES, folder / "ellipses.png"
    )
    return results


def publish_study(study: Study, docs: Path) -> None:
    """Write a study's page and pictures from the results that are there."""
    folder = docs / "results"
    results = Results.read(folder / RESULTS).of(study.name)
    (folder / f"{study.name}.md").write_text(tables.page(study, results), encoding="utf-8")
    given = {row.method: row.given_states for row in study.rows()}
    order = list(given)
    if results.cells and study.by_scenes:
        plots.draw_conditions(results, folder / tables.bars_name(study))
        return
    if results.cells:
        plots.draw_bars(results, given, folder / tables.bars_name(study))
    for case in study.cases:
        curves = tables.curves_of(results, case)
        if curves:
            in_order = sorted(curves, key=lambda curve: order.index(curve.method))
            plots.draw_errors(in_order, folder / tables.curves_name(study, case))


def _examples(folders: Sequence[Path], sets_of: SetsOf) -> list[tuple[str, Window, Forecasts]]:
    """First test scene of every scenario, forecast by the models that predict covariances."""
    examples: list[tuple[str, Window, Forecasts]] = []
    for folder in folders:
        if Manifest.read(folder / MANIFEST_FILE).covariance.source != "predicted":
            continue
        manifest, predictor = load_exported(folder)
        sets = sets_of(manifest.simulated, manifest.objects, manifest.final_step)
        first = [replace(part, windows=part.windows[:1]) for part in sets]
        forecasts = with_covariance(run(predictor, first), manifest.covariance)
        examples += [
            (
                f"{manifest.label}, {part.scenario}",
                part.windows[0],
                _until(forecasts[part.scenario], manifest.trained_horizon),
            )
            for part in first
        ]
    return examples


def _until(made: Forecasts, horizon: int) -> Forecasts:
    """Cut forecasts to their first steps."""
    return Forecasts(
        made.positions[:, :, :horizon],
        None if made.covariances is None else made.covariances[:, :, :horizon],
        None if made.angular_velocities is None else made.angular_velocities[:, :, :horizon],
        made.true_positions[:, :, :horizon],
        made.true_angular_velocities[:, :, :horizon],
    )
