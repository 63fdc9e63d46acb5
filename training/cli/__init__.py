"""Commands of ``python -m training``, a module for each group of them."""

import typer
from typer.core import TyperGroup

from training.cli import balls, data, footage, models, studies, train

HELP = """\
Simulates scenes, trains networks and exports them for the service.

Data sets and checkpoints are stored in the folder ROLLCAST_RUNS (default: runs).

\b
A first experiment, a few minutes on one core:
  python -m training train tiny
  python -m training export tiny --scenes 100 --ood-scenes 0
  make serve
"""


class _Commands(TyperGroup):
    """Commands that Ctrl-C ends with one line, whatever they do."""

    def invoke(self, ctx: typer.Context) -> object:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("\ninterrupted; the same command goes on from what is kept", err=True)
            raise typer.Exit(train.INTERRUPTED) from None


def application() -> typer.Typer:
    """Make the command line."""
    app = typer.Typer(
        name="python -m training",
        cls=_Commands,
        help=HELP,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,  # help that is text can be piped and searched
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    for group in (data, train, balls, models, footage, studies):
        group.add_to(app)
    return app
