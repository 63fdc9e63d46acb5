"""Commands for a user's own set-up: networks trained on clips, and the page of real footage."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from rollcast.errors import FootageError
from training.cli.options import Balls, SplitClips, failed, one_of, recipe_of, show
from training.common.run_folder import BEST
from training.common.settings import runs_folder
from training.data.clip_dataset import Clips, load_clips
from training.data.splits import Split
from training.recipes import RECIPES
from training.recipes.recipe import Recipe
from training.reporting import footage_page
from training.reporting.footage_report import BASELINES, SetupClips, markdown, measure
from training.studies.publish import DOCS

PREFIX = "setup-"
Baselines = Annotated[
    list[str] | None,
    typer.Option(
        callback=one_of(BASELINES),
        help="baseline to measure; repeat it for several (default: all)",
    ),
]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("setup")(setup)
    app.command("real")(real)


def setup(
    recipe: Annotated[
        str,
        typer.Argument(
            callback=one_of(name for name in RECIPES if name.startswith(PREFIX)),
            metavar="RECIPE",
        ),
    ],
    data: Annotated[Path, typer.Option(metavar="FOLDER", help="clips with tracks")],
    balls: Balls = None,
    baselines: Baselines = None,
) -> None:
    """Measure networks trained on clips, and the baselines, on the test clips."""
    show(_measured(recipe, data, balls, baselines or list(BASELINES)))


def real(
    clips: Annotated[Path, typer.Argument(metavar="FOLDER", help="the clips that it lists")],
    baselines: Baselines = None,
) -> None:
    """Track, train and measure docs/results/real.md, where its clips are."""
    show(_page(clips, baselines or list(BASELINES)))


def clips_of(recipe: str, data: Path | None, balls: Sequence[int] | None) -> SplitClips | None:
    """Return the clips that a command was given; None for a recipe on scenes."""
    try:
        return setup_clips(recipe_of(recipe), data, balls)
    except FootageError as error:
        failed(error)


def _measured(
    name: str, data: Path, balls: Sequence[int] | None, baselines: Sequence[str]
) -> Iterator[str]:
    recipe = recipe_of(name)
    if not data.is_dir():
        yield f"skipped: no clips at {data}"
        return
    clips = clips_of(name, data, balls)
    assert clips is not None
    setup = SetupClips(clips)
    there = (runs_folder() / recipe.name / BEST).exists()
    rows = list(measure(setup, baselines, [recipe] if there else []))
    yield markdown(rows, setup)


def _page(clips: Path, baselines: Sequence[str]) -> Iterator[str]:
    missing = [
        file
        for filmed in (footage_page.ARENA, *footage_page.POOL)
        for file in filmed.clips
        if not (clips / file).exists()
    ]
    if missing:
        yield f"skipped: {clips} has no {', '.join(missing)}"
        return
    yield from footage_page.make(clips, DOCS / "results" / "real.md", baselines)


def setup_clips(
    recipe: Recipe, folder: Path | None, balls: Sequence[int] | None
) -> dict[Split, Clips] | None:
    """Return the clips that a recipe for footage trains on; None for simulated scenes.

    Parameters
    ----------
    balls
        Numbers of the balls to forecast; None for all, and with one ball the first.

    Raises
    ------
    FootageError
        When recipe, folder and balls do not fit, or the folder cannot be read.
    """
    if folder is None:
        if recipe.scenarios:
            return None
        raise FootageError(f"{recipe.name} is trained on clips; pass their folder with --data")
    if recipe.scenarios:
        raise FootageError(
            f"{recipe.name} is trained on simulated scenes; --data is for the recipes setup-..."
        )
    objects = recipe.task.objects
    splits = load_clips(folder)
    there = len(splits["training"][0].positions)
    chosen = balls or ([0] if objects == 1 else list(range(there)))
    if len(chosen) != objects or not set(chosen) <= set(range(there)):
        raise FootageError(
            f"{recipe.name} forecasts {objects} of the clips' balls 0 to {there - 1}, --balls "
            f"selects {', '.join(map(str, chosen))}"
        )
    return {split: Clips(clips, chosen) for split, clips in splits.items() if clips}
