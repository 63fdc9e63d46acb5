"""Model card of an exported model: architecture, training data, measured errors."""

from collections.abc import Sequence

from rollcast.manifest import CovarianceSource, MetricRow
from training.data.clip_dataset import EVERY
from training.evaluation.evaluate import markdown_table
from training.export.spec import Trained

ARCHITECTURES = {
    "field": "FieldNet, a network with an explicit state: ground map, ball positions, velocities",
    "zoomed": "FieldNet with a second, zoomed pass of its perception",
    "perception_init": "a recurrent network with an 8 x 8 x 128 state from FieldNet's perception",
    "compact": "the paper's network with a smaller encoder and an 8 x 8 x 128 state",
    "paper": "the paper's network with VGG16 and an 8 x 8 x 512 state",
}
"""Architecture of every preset, in words."""
EXPLICIT = frozenset({"field", "zoomed", "perception_init"})
"""Presets whose networks are also supervised by the simulator's ground, heights and velocities."""


def model_card(
    trained: Trained, version: int, rows: Sequence[MetricRow], covariance: CovarianceSource
) -> str:
    """Model card in Markdown, with the measured error whatever it is.

    Parameters
    ----------
    rows
        Errors on the validation and the test split.
    """
    recipe, name, horizon = trained.recipe, trained.name, trained.horizon
    source = {
        "predicted": "predicted by the network, times a scale per step fitted on validation",
        "empirical": "the covariance of the network's own validation residuals at each step",
    }[covariance.source]
    frames = "four 128 x 128 frames"
    if recipe.task.final_step is not None:
        frames += f" and the one of step {recipe.task.final_step}"
    if trained.filmed is None:
        origin = "simulated scenes"
        limits = "simulated scenes of these scenarios only"
        measured = "scenes that were not used in training, from the fixed test start"
    else:
        origin = "windows of clips"
        limits = "the set-up of these clips, their camera, light and balls only"
        measured = f"windows of clips that were not used in training, one every {EVERY} frames"
    sources = ", ".join(f"{count} {source}" for source, count in trained.sources.items())
    others = [member.name for member in recipe.members if member.name != name]
    together = (
        f"\n  Trained together with {', '.join(others)}: the state is shared." if others else ""
    )
    return f"""# {name}@{version}

{recipe.member(name).variant} ({recipe.preset} preset), {recipe.task.objects} ball(s), scenarios
{", ".join(trained.scenarios)}. It observes {frames} at {trained.frame_rate_hz:g} Hz and was trained
to forecast {horizon} steps.

- Architecture: {ARCHITECTURES[recipe.preset]}. Supervision: {_supervision(trained)}.
- Trained on {trained.sequences:,} sequences from {origin}: {sources}.{together}
- Uncertainty: {source}.
- Limits: {limits}; beyond step {horizon} it
  extrapolates beyond its training.
- Licence: {trained.licence}.

## Measured

Errors in pixels of 128 x 128 frames, mean over {measured}; T is the
horizon, so the error is that of step T - 1. "Constant position" and "linear extrapolation"
(through ten true positions, t = -3..6) are measured on the same scenes.

### Test

{markdown_table([row for row in rows if row.split == "test"])}

### Validation

{markdown_table([row for row in rows if row.split == "validation"])}
"""


def _supervision(trained: Trained) -> str:
    """Name the quantities that supervised a network."""
    parts = ["positions"]
    if trained.recipe.task.angular_velocity:
        parts.append("angular velocities")
    if trained.recipe.preset in EXPLICIT and trained.filmed is None:
        parts += ["ground maps", "heights", "3-D velocities"]
    return ", ".join(parts)
