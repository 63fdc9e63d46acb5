"""The card of an exported model: what it is, what it was trained on, how well it does."""

from collections.abc import Sequence

from rollcast.manifest import CovarianceSource, MetricRow
from training.data.clip_dataset import EVERY
from training.evaluation.evaluate import markdown_table
from training.export.spec import Trained


def model_card(
    trained: Trained, version: int, rows: Sequence[MetricRow], covariance: CovarianceSource
) -> str:
    """Model card in Markdown, with the measured error whatever it is.

    Parameters
    ----------
    rows
        What was measured on the validation and the test split.
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
        whence = "simulated scenes"
        limits = "simulated scenes of these scenarios only"
        measured = "scenes that training never saw, from the fixed test start"
    else:
        whence = "windows of clips"
        limits = "the set-up of these clips, their camera, light and balls only"
        measured = f"windows of clips that training never saw, one every {EVERY} frames"
    sources = ", ".join(f"{count} {source}" for source, count in trained.sources.items())
    others = [member.name for member in recipe.members if member.name != name]
    together = (
        f"\n  Trained together with {', '.join(others)}: the state is shared." if others else ""
    )
    return f"""# {name}@{version}

{recipe.member(name).variant} ({recipe.preset} preset), {recipe.task.objects} ball(s), scenarios
{", ".join(trained.scenarios)}. It sees {frames} at {trained.frame_rate_hz:g} Hz and was trained
to forecast {horizon} steps.

- Trained on {trained.sequences:,} sequences from {whence}: {sources}.{together}
- Uncertainty: {source}.
- Limits: {limits}; beyond step {horizon} it
  extrapolates past its training.
- Licence: {trained.licence}.

## Measured

128-pixel units, mean over {measured}; T is the
horizon, so the error is that of step T - 1. "Constant position" and "linear extrapolation"
(through ten true positions, t = -3..6) are measured on the same scenes.

### Test

{markdown_table([row for row in rows if row.split == "test"])}

### Validation

{markdown_table([row for row in rows if row.split == "validation"])}
"""
