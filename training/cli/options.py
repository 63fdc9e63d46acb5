"""Options that several commands share."""

import importlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Annotated, NoReturn, TypeAlias, TypeVar

import typer

from training.common.devices import chosen_device
from training.data.clip_dataset import Clips
from training.data.splits import Split
from training.recipes import RECIPES
from training.recipes.recipe import Recipe

MODELS = Path("models")
CORES = os.cpu_count() or 1
Names = TypeVar("Names", str, list[str] | None)

Workers: TypeAlias = Annotated[int, typer.Option(min=1, help="processes that simulate scenes")]
TestScenes: TypeAlias = Annotated[int, typer.Option(min=1, help="test scenes per scenario")]


def existing_device(name: str) -> str:
    """Return the name of a device, or refuse one that this torch does not have."""
    try:
        chosen_device(name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    return name


Device: TypeAlias = Annotated[
    str,
    typer.Option(
        callback=existing_device,
        metavar="DEVICE",
        help="device of torch: cpu, cuda, cuda:1, ...; auto is a GPU if there is one",
    ),
]


def one_of(names: Iterable[str]) -> Callable[[Names], Names]:
    """Return a callback that refuses values which are not among some names."""
    known = list(names)

    def check(value: Names) -> Names:
        given = [value] if isinstance(value, str) else value or []
        for name in given:
            if name not in known:
                raise typer.BadParameter(f"{name!r} is not one of {', '.join(known)}")
        return value

    return check


RecipeName: TypeAlias = Annotated[str, typer.Argument(callback=one_of(RECIPES), metavar="RECIPE")]
Model: TypeAlias = Annotated[Path, typer.Argument(help="models/NAME/VERSION")]
Data: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="clips with tracks (rollcast track) for the recipes setup-...: your own set-up",
    ),
]
Balls: TypeAlias = Annotated[
    list[int] | None,
    typer.Option(
        metavar="BALL",
        help="one of the clips' balls to forecast; repeat it for several (default: all, for "
        "setup-one-ball the first)",
    ),
]


def ray_option(what: str) -> typer.models.OptionInfo:
    """Return the option --ray of a command."""
    return typer.Option(
        metavar="ADDRESS",
        help=f'{what}: address of a Ray cluster, "auto" for a cluster on this machine or "local" '
        "for a temporary one (needs the extra ray-training)",
    )


def with_ray() -> ModuleType:
    """Import the Ray backend, which requires an extra."""
    try:
        return importlib.import_module("training.orchestration.ray_backend")
    except ModuleNotFoundError as error:
        failed(
            f"--ray needs the extra ray-training ({error}); `tools/environment.sh test` makes "
            ".venv/test, which includes it"
        )


def failed(message: object) -> NoReturn:
    """End the command with one line for the user."""
    typer.echo(message, err=True)
    raise typer.Exit(1)


def show(lines: Iterable[str]) -> None:
    """Print lines as they come."""
    for line in lines:
        typer.echo(line)


def recipe_of(name: str) -> Recipe:
    """Return the recipe of a name."""
    return RECIPES[name]()


SplitClips: TypeAlias = dict[Split, Clips]
