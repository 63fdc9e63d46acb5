"""What ``python -m training`` does with clips: its commands and options for a user's own set-up."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rollcast.errors import FootageError
from training.common.settings import runs_folder
from training.data.clip_dataset import Clips, load_clips
from training.data.splits import Split
from training.engine.trainer import BEST
from training.recipes import RECIPES
from training.recipes.recipe import Recipe
from training.reporting import footage_page
from training.reporting.footage_report import BASELINES, Rig, markdown, measure
from training.studies.publish import DOCS


def add(commands: "argparse._SubParsersAction[Any]", show: Callable[[Iterable[str]], None]) -> None:
    """Add the commands ``rig`` and ``real``.

    Parameters
    ----------
    show
        Tells the user what a command says, as it comes.
    """
    rig = commands.add_parser(
        "rig", help="measure networks trained on clips, and the baselines, on the test clips"
    )
    rig.add_argument("recipe", choices=[name for name in RECIPES if name.startswith("rig-")])
    rig.add_argument("--data", type=Path, required=True, metavar="FOLDER", help="clips with tracks")
    rig.add_argument("--balls", type=int, nargs="+", metavar="BALL", help="as they were trained")
    _add_baselines(rig)
    rig.set_defaults(run=lambda arguments: show(_rig(arguments)))

    footage = commands.add_parser(
        "real", help="track, train and measure docs/results/real.md, where its clips are"
    )
    footage.add_argument("clips", type=Path, metavar="FOLDER", help="the clips that it names")
    _add_baselines(footage)
    footage.set_defaults(run=lambda arguments: show(_real(arguments)))


def _add_baselines(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--baselines", nargs="*", choices=BASELINES, default=list(BASELINES), help="default: all"
    )


def add_options(command: argparse.ArgumentParser) -> None:
    """Add what :func:`clips_of` reads to a command that also knows scenes."""
    command.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        help="clips with tracks (rollcast track) for the recipes rig-...: your own set-up",
    )
    command.add_argument(
        "--balls",
        type=int,
        nargs="+",
        metavar="BALL",
        help="of the clips' balls, those to forecast (default: all, for rig-one-ball the first)",
    )


def clips_of(arguments: argparse.Namespace) -> dict[Split, Clips] | None:
    """Return the clips that a command was given; None for a recipe on scenes."""
    try:
        return rig_clips(RECIPES[arguments.recipe](), arguments.data, arguments.balls)
    except FootageError as error:
        raise SystemExit(str(error)) from error


def _rig(arguments: argparse.Namespace) -> Iterator[str]:
    recipe = RECIPES[arguments.recipe]()
    if not arguments.data.is_dir():
        yield f"skipped: there are no clips at {arguments.data}"
        return
    clips = clips_of(arguments)
    assert clips is not None
    rig = Rig(clips)
    there = (runs_folder() / recipe.name / BEST).exists()
    rows = list(measure(rig, arguments.baselines, [recipe] if there else []))
    yield markdown(rows, rig)


def _real(arguments: argparse.Namespace) -> Iterator[str]:
    missing = [
        file
        for filmed in (footage_page.ARENA, *footage_page.POOL)
        for file in filmed.clips
        if not (arguments.clips / file).exists()
    ]
    if missing:
        yield f"skipped: {arguments.clips} has no {', '.join(missing)}"
        return
    page = DOCS / "results" / "real.md"
    yield from footage_page.make(arguments.clips, page, arguments.baselines)


def rig_clips(
    recipe: Recipe, folder: Path | None, balls: Sequence[int] | None
) -> dict[Split, Clips] | None:
    """Return what a recipe trains on where it is made for footage; None for simulated scenes.

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
        raise FootageError(f"{recipe.name} is trained on clips; name their folder with --data")
    if recipe.scenarios:
        raise FootageError(
            f"{recipe.name} is trained on simulated scenes; --data is for the recipes rig-..."
        )
    objects = recipe.task.objects
    splits = load_clips(folder)
    there = len(splits["training"][0].positions)
    chosen = balls or ([0] if objects == 1 else list(range(there)))
    if len(chosen) != objects or not set(chosen) <= set(range(there)):
        raise FootageError(
            f"{recipe.name} forecasts {objects} of the clips' balls 0 to {there - 1}, "
            f"--balls names {', '.join(map(str, chosen))}"
        )
    return {split: Clips(clips, chosen) for split, clips in splits.items() if clips}
