"""Commands that measure the paper's tables and write the pages."""

from pathlib import Path
from typing import Annotated

import typer

from rollcast.manifest import MANIFEST_FILE, Manifest
from training.cli.options import CORES, MODELS, Workers, failed, one_of
from training.engine.loop import TrainingStoppedError
from training.reporting.markdown import with_results
from training.reporting.results import Results, committed
from training.studies import STUDIES, reproduced
from training.studies.publish import DOCS, RESULTS, publish_study
from training.studies.rows import BUDGET, STATE_BUDGET, StudyBudget

README = Path("README.md")


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("study")(study)
    app.command("report")(report)


def study(
    name: Annotated[
        str, typer.Argument(callback=one_of(STUDIES), metavar="STUDY", help=", ".join(STUDIES))
    ],
    rows: Annotated[
        list[str] | None,
        typer.Option(metavar="METHOD", help="only this row; repeat it for several"),
    ] = None,
    scenes: Annotated[int, typer.Option(min=1, help="test scenes of every case")] = 500,
    sequences: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="training sequences of each scenario for every trained row (default: "
            f"{BUDGET:,}, from true states {STATE_BUDGET:,})",
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="number of trainings per row; the tables show their spread")
    ] = 1,
    workers: Workers = CORES,
) -> None:
    """Train and measure the rows that a study's table lacks, into docs/results."""
    chosen = STUDIES[name]
    budget = StudyBudget(workers, sequences, seeds)
    try:
        for done in chosen.run(DOCS / "results" / RESULTS, scenes, budget, rows or ()):
            typer.echo(done)
            publish_study(chosen, DOCS)
    except (ValueError, TrainingStoppedError) as error:
        failed(error)


def report() -> None:
    """Write the README's table, the studies' pages and docs/reproduced.md from the results."""
    manifests = [Manifest.read(folder / MANIFEST_FILE) for folder in committed(MODELS)]
    text = README.read_text(encoding="utf-8")
    README.write_text(with_results(text, manifests), encoding="utf-8")
    for one in STUDIES.values():
        publish_study(one, DOCS)
    results = Results.read(DOCS / "results" / RESULTS)
    (DOCS / reproduced.NAME).write_text(reproduced.page(results), encoding="utf-8")
