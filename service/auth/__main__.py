"""``python -m service.auth``: make, list and remove API keys."""

from collections.abc import Generator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from service.auth.api_keys import SCOPES, Key, KeyFile, Scope, digest, exclusively, new_token

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


@app.callback()
def _with_file(
    context: typer.Context,
    file: Annotated[Path, typer.Option(metavar="FILE", help="key file (JSON)")],
) -> None:
    """Create, list and remove the API keys in a key file.

    A service with ROLLCAST_KEYS_FILE=FILE requires one of them (Authorization: Bearer KEY) and
    reloads the file when it changes.
    """
    context.obj = file


@app.command()
def add(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="letters, digits, dot, dash, underscore")],
    scopes: Annotated[
        list[str] | None,
        typer.Option(
            "--scope",
            help="forecast (default), manage (load and unload models), metrics; repeat it for "
            "several",
        ),
    ] = None,
    expires: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d"], metavar="YYYY-MM-DD", help="last day on which the key is valid"
        ),
    ] = None,
) -> None:
    """Create a key and print it once; the file stores only its hash."""
    granted: list[Scope] = [_known_scope(scope) for scope in scopes or ["forecast"]]
    with _key_file(context) as (path, known):
        if any(key.name == name for key in known.keys):
            raise ValueError(f"has a key {name!r} already")
        token = new_token()
        key = Key(
            name=name,
            sha256=digest(token),
            scopes=tuple(dict.fromkeys(granted)),
            expires=None if expires is None else expires.date(),
        )
        KeyFile(keys=(*known.keys, key)).write(path)
    typer.echo(token)


@app.command("list")
def list_keys(context: typer.Context) -> None:
    """List names, scopes and expiry."""
    with _key_file(context) as (_, known):
        for key in known.keys:
            until = "" if key.expires is None else f", until {key.expires}"
            typer.echo(f"{key.name}: {', '.join(key.scopes)}{until}")


@app.command()
def remove(context: typer.Context, name: str) -> None:
    """Remove a key; the service rejects it within a second."""
    with _key_file(context) as (path, known):
        kept = tuple(key for key in known.keys if key.name != name)
        if len(kept) == len(known.keys):
            raise ValueError(f"has no key {name!r}")
        KeyFile(keys=kept).write(path)


def _known_scope(text: str) -> Scope:
    for scope in SCOPES:
        if text == scope:
            return scope
    known = ", ".join(SCOPES)
    raise typer.BadParameter(f"{text!r} is not one of {known}", param_hint="'--scope'")


@contextmanager
def _key_file(context: typer.Context) -> Generator[tuple[Path, KeyFile]]:
    """Yield the path and the keys of the file, locked; errors end the command with exit code 1."""
    path: Path = context.obj
    try:
        with exclusively(path):
            yield path, KeyFile.read(path) if path.exists() else KeyFile()
    except (OSError, ValueError) as error:
        typer.echo(f"rollcast: {path}: {error}", err=True)
        raise typer.Exit(1) from error


if __name__ == "__main__":
    app(prog_name="python -m service.auth")
