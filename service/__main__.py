"""``python -m service``: serve the models of this checkout, or of the package of models."""

import sys


def main() -> None:
    """Run the command line."""
    # Imported here because the process that simulates imports this module again.
    from service.command_line import application

    application()(prog_name="python -m service")


if __name__ == "__main__":
    sys.exit(main())
