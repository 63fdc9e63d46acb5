"""Commands that measure, take apart, export and convert models."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from rollcast.client import Client
from rollcast.manifest import MANIFEST_FILE, Manifest
from rollcast.scene import Scenario
from rollcast.schemas import AUTO_MODEL
from training.cli import footage
from training.cli.options import (
    CORES,
    MODELS,
    Balls,
    Data,
    Model,
    RecipeName,
    TestScenes,
    Workers,
    failed,
    recipe_of,
)
from training.common.settings import runs_folder
from training.data.shards import Source
from training.evaluation.error_breakdown import breakdown_of, breakdown_table
from training.evaluation.evaluate import evaluation_sets, markdown_table, metric_rows, run
from training.evaluation.frame_rates import measure as measure_frame_rates
from training.evaluation.frame_rates import results_table as rates_table
from training.evaluation.perturbations import measure as measure_perturbations
from training.evaluation.perturbations import results_table
from training.evaluation.real_clips import any_ball_finder, perception_finder
from training.evaluation.real_clips import table as real_clips_table
from training.evaluation.tracked_clips import table as tracked_clips_table
from training.export.any_ball import BallGraphs
from training.export.export import export_run, with_covariance
from training.export.footage import export_setup
from training.export.load import load_exported
from training.export.ood_fit import OOD_SCENES, fit_ood_detectors, fit_place_uncertainties
from training.export.static_quantisation import NotWorthItError
from training.export.static_quantisation import quantise as quantise_model
from training.networks.fieldnet import FieldNet
from training.networks.recurrent import Network
from training.studies.publish import DOCS, publish

TRACKED_CLIPS_PAGE = """\
# Balls tracked in real clips

Written by `python -m training tracked-clips ADDRESS PID CLIPS TRACKS --page`. Clips are those of
[balls found in real clips](real-clips.md) and others of the same kinds; some balls were tracked by
hand. They serve for evaluation only. Every clip is tracked by `rollcast track` without options.

`repeated` are frames that repeat the one before and were left out. `found` is the share of frames
in which the balls that move were found. A ball that was tracked by hand counts as tracked where a
track lies within its radius; `switches` counts how often this track is another one than before.
Processor time is that of the command and of the service together, per second of the clip, on one
machine with other work on it. MiB is the peak memory of the command.

{table}
"""
REAL_CLIPS_PAGE = """# Balls found in real clips

Written by `python -m training real-clips MODEL CLIPS TRACKS --page`, for `{label}`. The clips show
pool, snooker, pucks and a tilting plate; their balls were tracked by hand. They serve for
evaluation only: no model was trained on them. A window has four frames, cut out of the clip and
scaled to 128 x 128 pixels, in which a ball moves.

A ball is found if its place at t = 0 errs by at most its radius, or 2 px if the radius is smaller.
Without a prompt the nearest of the balls that the model answers with counts. A prompt is a point
near the centre of the ball (standard deviation 1.5 px along each axis). The displacement is the one
between the last two frames; its error is given as median / mean over all windows.

{table}
"""
PERTURBATIONS_PAGE = """# Perturbed frames

Written by `python -m training perturbations URL --page`, for the model `{model}` of a running
service. Each row shows the mean error at T=20, in pixels of 128 x 128 frames, on {scenes} test
scenes per scenario whose frames were perturbed. The ratio is the error relative to the unperturbed
one, averaged over the scenarios.

{table}
"""
FRAME_RATES_PAGE = """# Frame rates

Written by `python -m training frame-rates URL --page`, for the model `{model}` of a running
service. Each row shows the mean error after half a second, in pixels of 128 x 128 frames, on
{scenes} test scenes per scenario that are filmed at another rate; `frame_rate` tells the service.
At 15 frames a second the first step after half a second counts. The ratio is the error relative to
that at 40 frames a second, averaged over the scenarios.

{table}
"""
BOWLS_AND_HEIGHTFIELDS: tuple[Scenario, ...] = ("hemisphere", "ellipsoid", "heightfield")
Version = Annotated[int, typer.Option(min=1)]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("evaluate")(evaluate)
    app.command("error-breakdown")(error_breakdown)
    app.command("real-clips")(real_clips)
    app.command("tracked-clips")(tracked_clips)
    app.command("perturbations")(perturbations)
    app.command("frame-rates")(frame_rates)
    app.command("export")(export)
    app.command("quantise")(quantise)
    app.command("fit-ood")(fit_ood)


def real_clips(
    model: Annotated[Path, typer.Argument(help="models/NAME/VERSION")],
    clips: Annotated[Path, typer.Argument(help="folder of videos")],
    tracks: Annotated[Path, typer.Argument(help="folder of setup.json and one table per clip")],
    page: Annotated[
        bool, typer.Option("--page", help="write the table into docs/results/real-clips.md")
    ] = False,
) -> None:
    """Measure how often a model finds the ball in real clips with tracks."""
    if Manifest.read(model / MANIFEST_FILE).max_objects is None:
        finder = perception_finder(load_exported(model)[1])
    else:
        graphs = BallGraphs(model)
        finder = any_ball_finder(graphs.detect, graphs.refine)
    lines = _shown(real_clips_table(finder, clips, tracks))
    if page:
        label = Manifest.read(model / MANIFEST_FILE).label
        _write_page("real-clips", REAL_CLIPS_PAGE.format(label=label, table=lines))


def tracked_clips(
    url: Annotated[str, typer.Argument(help="address of a running service")],
    service: Annotated[int, typer.Argument(help="id of its process, on this machine")],
    clips: Annotated[Path, typer.Argument(help="folder of videos")],
    tracks: Annotated[Path, typer.Argument(help="folder of setup.json and one table per clip")],
    page: Annotated[
        bool, typer.Option("--page", help="write the table into docs/results/tracked-clips.md")
    ] = False,
) -> None:
    """Measure `rollcast track` on real clips with tracks."""
    lines = _shown(tracked_clips_table(url, service, clips, tracks))
    if page:
        _write_page("tracked-clips", TRACKED_CLIPS_PAGE.format(table=lines))


def perturbations(
    url: Annotated[str, typer.Argument(help="address of a running service")],
    model: Annotated[str, typer.Option(help="auto, NAME or NAME@VERSION")] = AUTO_MODEL,
    scenes: Annotated[int, typer.Option(min=1, help="test scenes per scenario")] = 14,
    workers: Workers = CORES,
    page: Annotated[
        bool, typer.Option("--page", help="write the table into docs/results/perturbations.md")
    ] = False,
) -> None:
    """Measure a running service on perturbed frames of simulated scenes."""
    sets = evaluation_sets(BOWLS_AND_HEIGHTFIELDS, 1, None, "test", scenes, workers)
    with Client(url) as service:
        measured = list(measure_perturbations(service, sets, model))
    page_text = PERTURBATIONS_PAGE if page else None
    _tell("perturbations", results_table(measured), page_text, model, scenes)


def frame_rates(
    url: Annotated[str, typer.Argument(help="address of a running service")],
    model: Annotated[str, typer.Option(help="auto, NAME or NAME@VERSION")] = AUTO_MODEL,
    scenes: Annotated[int, typer.Option(min=1, help="test scenes per scenario")] = 50,
    workers: Workers = CORES,
    page: Annotated[
        bool, typer.Option("--page", help="write the table into docs/results/frame-rates.md")
    ] = False,
) -> None:
    """Measure a running service on simulated scenes that are filmed at other rates."""
    with Client(url) as service:
        made = measure_frame_rates(service, BOWLS_AND_HEIGHTFIELDS, scenes, workers, model)
        measured = list(made)
    page_text = FRAME_RATES_PAGE if page else None
    _tell("frame-rates", rates_table(measured), page_text, model, scenes)


def _tell(name: str, text: str, page_text: str | None, model: str, scenes: int) -> None:
    """Print the table of a running service, and write its page if there is a text for it."""
    if page_text is not None:
        _write_page(name, page_text.format(model=model, scenes=scenes, table=text))
    typer.echo(text)


def _shown(lines: Iterable[str]) -> str:
    """Print lines as they come; return them as one text."""
    kept: list[str] = []
    for line in lines:
        typer.echo(line)
        kept.append(line)
    return "\n".join(kept)


def _write_page(name: str, text: str) -> None:
    (DOCS / "results" / f"{name}.md").write_text(text, encoding="utf-8")


def _loaded(model: Path) -> tuple[Manifest, Network]:
    try:
        return load_exported(model)
    except ValueError as error:
        failed(error)


def evaluate(
    model: Annotated[Path | None, typer.Argument(help="models/NAME/VERSION")] = None,
    every: Annotated[
        bool,
        typer.Option("--all", help="every committed model, into docs/results (test split)"),
    ] = False,
    split: Annotated[Literal["validation", "test"], typer.Option()] = "test",
    scenes: Annotated[int, typer.Option(min=1, help="scenes per scenario")] = 500,
    workers: Workers = CORES,
) -> None:
    """Measure exported models on fixed scenes."""
    if (model is None) != every:
        failed("pass one model (models/NAME/VERSION), or --all")
    if model is None:
        if split != "test":
            failed(f"--all measures the test split, not --split {split}")
        results = publish(MODELS, DOCS, scenes, workers)
        typer.echo(f"{len(results.cells)} figures in {DOCS / 'results.md'}")
        return
    manifest, predictor = _loaded(model)
    kind = (manifest.simulated, manifest.objects, manifest.final_step)
    sets = evaluation_sets(*kind, split, scenes, workers)
    forecasts = with_covariance(run(predictor, sets), manifest.covariance)
    typer.echo(markdown_table(metric_rows(sets, forecasts, manifest.trained_horizon)))


def error_breakdown(
    model: Model,
    scenes: Annotated[int, typer.Option(min=1, help="scenes per scenario")] = 100,
    workers: Workers = CORES,
) -> None:
    """Take the validation error of a fieldnet apart: parts of its state from the truth."""
    manifest, network = load_exported(model)
    if not isinstance(network, FieldNet):
        failed(f"{manifest.label} is a {manifest.variant}; only the state of a fieldnet has parts")
    errors = {
        scenario: breakdown_of(network, Source(scenario, manifest.objects), scenes, workers)
        for scenario in manifest.simulated
    }
    typer.echo(breakdown_table(errors, manifest.objects))


def export(
    recipe: RecipeName,
    version: Version = 1,
    models: Annotated[Path, typer.Option(help="output folder for the models")] = MODELS,
    scenes: TestScenes = 500,
    data: Data = None,
    balls: Balls = None,
    name: Annotated[
        str | None, typer.Option(help="name of a model for clips (default: the recipe's)")
    ] = None,
    ood_scenes: Annotated[
        int,
        typer.Option(min=0, help="scenes to fit the out-of-distribution score to; 0 for none"),
    ] = OOD_SCENES,
    workers: Workers = CORES,
) -> None:
    """Export a recipe's best networks and validate the exports."""
    chosen, folder = recipe_of(recipe), runs_folder() / recipe
    clips = footage.clips_of(recipe, data, balls)
    try:
        if clips is not None:
            called = name or chosen.members[0].name
            _show([export_setup(chosen, folder, clips, models, called, version)])
            return
        manifests = export_run(chosen, folder, models, version, scenes, workers)
    except FileNotFoundError as error:
        failed(
            f"no trained weights at {error.filename}: run `python -m training train {recipe}` "
            "first, or set ROLLCAST_RUNS to the folder of its runs"
        )
    complete(manifests, models, workers, ood_scenes)


def complete(
    manifests: Sequence[Manifest], models: Path, workers: int, ood_scenes: int = OOD_SCENES
) -> None:
    """Fit the out-of-distribution score of exports, and print how good they are."""
    folders = [models / manifest.name / str(manifest.version) for manifest in manifests]
    if ood_scenes:
        fit_ood_detectors(folders, ood_scenes, workers)
        fit_place_uncertainties(folders, ood_scenes, workers)
    _show(manifests)


def _show(manifests: Sequence[Manifest]) -> None:
    """Print how exports were validated and how well they do on the test split."""
    for manifest in manifests:
        typer.echo(f"## {manifest.label}\n")
        for output, error in manifest.parity.max_abs_error.items():
            tolerance = manifest.parity.tolerance[output]
            typer.echo(f"{output}: torch and ONNX differ by {error} (tolerance {tolerance})")
        typer.echo(
            f"\n{markdown_table([row for row in manifest.metrics if row.split == 'test'])}\n"
        )


def quantise(
    model: Model, version: Version = 2, scenes: TestScenes = 500, workers: Workers = CORES
) -> None:
    """Write another version of an exported model, faster in 8 bits, if it is worth it."""
    try:
        manifest = quantise_model(model, version, scenes, workers)
    except NotWorthItError as error:
        failed(error)
    typer.echo(f"{manifest.label}, from {manifest.training['quantised']}")


def fit_ood(
    models: Annotated[
        list[Path] | None,
        typer.Argument(help="models/NAME/VERSION (default: all committed ones)"),
    ] = None,
    scenes: Annotated[
        int, typer.Option(min=1, help="scenes per scenario for the fit")
    ] = OOD_SCENES,
    workers: Workers = CORES,
) -> None:
    """Write into exported models how to tell frames that they do not know."""
    folders = models or [
        path.parent
        for path in MODELS.glob(f"*/*/{MANIFEST_FILE}")
        if Manifest.read(path).max_objects is None
    ]
    for manifest in fit_ood_detectors(folders, scenes, workers):
        typer.echo(f"{manifest.label}: {manifest.ood}")
    for manifest in fit_place_uncertainties(folders, scenes, workers):
        typer.echo(f"{manifest.label}: {manifest.place_uncertainty}")
