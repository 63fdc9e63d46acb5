"""``python -m training``: simulate, train, evaluate, export."""

import sys

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main() -> None:
    """Run a command."""
    try:
        from training.cli import application
    except KeyboardInterrupt:  # importing takes seconds
        sys.exit(INTERRUPTED)
    application()()


if __name__ == "__main__":
    main()
