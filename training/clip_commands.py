"""What ``python -m training`` does with clips: its commands and options for a user's own set-up."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from rollcast.errors import FootageError
from training import real
from training.clips import Clips, rig_clips
from training.publish import DOCS
from training.recipes import RECIPES
from training.rig_report import BASELINES, Rig, markdown, measure
from training.settings import runs_folder
from training.splits import Split
from training.trainer import BEST


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
        for filmed in (real.ARENA, *real.POOL)
        for file in filmed.clips
        if not (arguments.clips / file).exists()
    ]
    if missing:
        yield f"skipped: {arguments.clips} has no {', '.join(missing)}"
        return
    page = DOCS / "results" / "real.md"
    yield from real.make(arguments.clips, page, arguments.baselines)
