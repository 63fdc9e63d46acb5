"""``rollcast models``: the service's models, and the rejected ones."""

from typing import Annotated, Literal

import typer

from rollcast.commands.options import Outcome, Url, client
from rollcast.commands.printing import as_json, as_table
from rollcast.schemas import ModelEntry

HELP = """\
List the models of a service, with the reason for rejected ones.

NAME without a version selects the version marked with *. The error is measured on validation
data, in pixels of 128 x 128 frames; HORIZON is the number of steps in the model's training.

\b
Examples:
  rollcast models
  rollcast models --format json
"""


def models(
    context: typer.Context,
    url: Url = None,
    form: Annotated[Literal["table", "json"], typer.Option("--format", help="output format")] = (
        "table"
    ),
) -> Outcome:
    """Ask for the models and list them."""
    with client(context, url) as service:
        entries = service.models()
    if form == "json":
        return Outcome(as_json([entry.model_dump(mode="json") for entry in entries]))
    if not entries:
        return Outcome("the service has no models")
    return Outcome(as_table([_row(entry) for entry in entries]))


def _row(entry: ModelEntry) -> dict[str, object]:
    """Describe a model in a line; of a refused one little may be known."""
    error_px = None if entry.metrics is None else entry.metrics.validation_error_px
    status = entry.status if entry.reason is None else f"{entry.status}: {entry.reason}"
    return {
        "MODEL": f"{entry.name}@{entry.version}{'*' if entry.default else ''}",
        "VARIANT": entry.variant or "",
        "BALLS": entry.objects or "",
        "FRAMES": entry.frames or "",
        "HORIZON": entry.trained_horizon or "",
        "ERROR_PX": "" if error_px is None else f"{error_px:.2f}",
        "SCENARIOS": ",".join(entry.scenarios or []),
        "STATUS": status,
    }
