"""``python -m training``: simulate, train, evaluate, export."""

import sys
from collections.abc import Sequence
from functools import partial

NAME = "python -m training"
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
PYTHON = ".venv/test/bin/python"
"""Interpreter that `make training` installs."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code.

    Parameters
    ----------
    arguments
        By default those of the process.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        from rollcast.commands.failures import exit_code
        from training.cli import application
    except KeyboardInterrupt:  # importing takes seconds
        return INTERRUPTED
    except ModuleNotFoundError as error:
        print(
            f"{NAME}: {sys.executable} has no {error.name}, which training needs: run "
            f"`make training`, then {PYTHON} -m training",
            file=sys.stderr,
        )
        return 1
    run = partial(application(), words or ["--help"], prog_name=NAME, standalone_mode=False)
    return exit_code(NAME, lambda: run() or 0)


if __name__ == "__main__":
    sys.exit(main())
