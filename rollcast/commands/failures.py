"""Failures of commands: one line on stderr and an exit code, never a traceback."""

import tempfile
import traceback
from collections.abc import Callable

import typer

from rollcast.commands.options import CommandError
from rollcast.errors import RollcastError, UnreachableError

USAGE = 2
"""Exit code for arguments that are wrong."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def exit_code(name: str, command: Callable[[], int]) -> int:
    """Run a command and return its exit code; a failure is one line on stderr.

    Parameters
    ----------
    name
        Name of the program.
    command
        Runs, and returns the exit code.
    """
    try:
        code = command()
    except typer.TyperException as error:
        path = getattr(getattr(error, "ctx", None), "command_path", name)
        return _failed(name, f"{error.format_message()} ({path} --help has more)", USAGE)
    except UnreachableError as error:
        return _failed(name, f"{error}; is the service running (make serve)?")
    except (RollcastError, CommandError, OSError) as error:
        return _failed(name, str(error))
    except KeyboardInterrupt:
        return _failed(name, "interrupted", INTERRUPTED)
    except Exception as error:
        return _failed(name, _unexpected(error))
    return code


def _unexpected(error: Exception) -> str:
    """Write the traceback of a fault of ours to a file, and return a line that names it."""
    with tempfile.NamedTemporaryFile(
        "w", prefix="rollcast-", suffix=".log", delete=False, encoding="utf-8", errors="replace"
    ) as file:
        file.writelines(traceback.format_exception(error))
    return f"unexpected {type(error).__name__}: {error}; this is a bug, details are in {file.name}"


def _failed(name: str, reason: str, code: int = 1) -> int:
    typer.echo(f"{name}: {' '.join(reason.splitlines())}", err=True)
    return code
