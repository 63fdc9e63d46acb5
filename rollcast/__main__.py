"""``rollcast``, or ``python -m rollcast``: the service from a shell.

Exit codes: 0 done, 1 it failed (one line on stderr says why), 2 the arguments are wrong, 130
interrupted.
"""

import os
import sys
import tomllib
from collections.abc import Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import typer

from rollcast.client import Client
from rollcast.client.settings import API_KEY_VARIABLE
from rollcast.commands import doctor, live, models, predict, serve, simulate, track
from rollcast.commands.failures import INTERRUPTED, exit_code
from rollcast.commands.options import Connect, Outcome

NAME = "rollcast"
HELP = """\
Forecast where rolling balls go. All commands except serve call a running service
(rollcast serve, or make serve).

\b
Example:
  rollcast serve &
  rollcast doctor
  rollcast simulate ellipsoid --seed 7 --out scene
  rollcast predict scene --out overlay.png

Exit codes: 0 success, 1 failure (with one line on stderr), 2 invalid arguments.
`rollcast --install-completion` completes commands and options in your shell.
"""
CHECKOUT = Path(__file__).resolve().parents[1]

app = typer.Typer(
    name=NAME,
    rich_markup_mode=None,  # help that is text can be piped and searched
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"{NAME} {_version()}")
        raise typer.Exit


def _version() -> str:
    """Return the version of the package, or of the checkout that is run."""
    try:
        return version(NAME)
    except PackageNotFoundError:
        text = (CHECKOUT / "pyproject.toml").read_text(encoding="utf-8")
        return str(tomllib.loads(text)["project"]["version"])


@app.callback(help=HELP)
def _with_key(
    context: typer.Context,
    show_version: Annotated[  # noqa: ARG001 - its callback does it
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="print the version"),
    ] = False,
    api_key: Annotated[
        str | None,
        typer.Option(
            metavar="KEY",
            help="API key, for a service that requires one; prefer the environment variable "
            f"{API_KEY_VARIABLE}",
            show_default=False,
        ),
    ] = None,
) -> None:
    if api_key is not None:
        context.obj = partial(context.obj, api_key=api_key)


for module in (serve, predict, live, simulate, track, models, doctor):
    name = module.__name__.rpartition(".")[2]
    app.command(name, help=module.HELP)(getattr(module, name))


def main(arguments: Sequence[str] | None = None, connect: Connect = Client) -> int:
    """Run one command and return the exit code.

    Parameters
    ----------
    arguments
        By default those of the process.
    connect
        Makes the client of an address.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    return exit_code(NAME, partial(_run, words, connect))


def _run(words: Sequence[str], connect: Connect) -> int:
    outcome = app(words or ["--help"], prog_name=NAME, obj=connect, standalone_mode=False)
    if not isinstance(outcome, Outcome):  # --help and its like have said it all
        if outcome == INTERRUPTED:
            raise KeyboardInterrupt
        return outcome or 0
    for warning in outcome.warnings:
        print(f"rollcast: warning: {warning}", file=sys.stderr)
    _print(outcome.text)
    if outcome.finish is not None:
        outcome.finish()
    return outcome.code


def _print(text: str) -> None:
    """Print a result, escaping characters that the terminal's encoding lacks."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader, `head` for example, has seen enough; Python would complain of it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def run() -> None:
    """Run the command of this process."""
    sys.exit(main())


if __name__ == "__main__":
    run()
