"""The card of an exported model: what it is, what it was trained on, how well it does."""

from collections.abc import Sequence

from rollcast.manifest import CovarianceSource, MetricRow
from rollcast.trajectory import FRAME_RATE_HZ
from training.evaluate import markdown_table
from training.recipes.recipe import Recipe

LICENCE = "Apache-2.0"


def model_card(
    recipe: Recipe,
    name: str,
    version: int,
    sequences: int,
    horizon: int,
    rows: Sequence[MetricRow],
    covariance: CovarianceSource,
) -> str:
    """Model card in Markdown, with the measured error whatever it is.

    Parameters
    ----------
    name
        The recipe's member.
    sequences
        Training sequences that its weights have seen.
    horizon
        Steps of the longest rollouts that trained them.
    rows
        What was measured on the validation and the test split.
    """
    source = {
        "predicted": "predicted by the network, times a scale per step fitted on validation",
        "empirical": "the covariance of the network's own validation residuals at each step",
    }[covariance.source]
    frames = "four 128 x 128 frames"
    if recipe.task.final_step is not None:
        frames += f" and the one of step {recipe.task.final_step}"
    scenes = ", ".join(f"{part.scenes} {part.source.name}" for part in recipe.data)
    others = [member.name for member in recipe.members if member.name != name]
    together = (
        f"\n  Trained together with {', '.join(others)}: the state is shared." if others else ""
    )
    return f"""# {name}@{version}

{recipe.member(name).variant} ({recipe.preset} preset), {recipe.task.objects} ball(s), scenarios
{", ".join(recipe.scenarios)}. It sees {frames} at {FRAME_RATE_HZ} Hz and was trained
to forecast {horizon} steps.

- Trained on {sequences:,} sequences from simulated scenes: {scenes}.{together}
- Uncertainty: {source}.
- Limits: simulated scenes of these scenarios only; beyond step {horizon} it
  extrapolates past its training.
- Licence: {LICENCE}.

## Measured

128-pixel units, mean over scenes that training never saw, from the fixed test start; T is the
horizon, so the error is that of step T - 1. "Stays put" and "line" (through ten true positions,
t = -3..6) are measured on the same scenes.

### Test

{markdown_table([row for row in rows if row.split == "test"])}

### Validation

{markdown_table([row for row in rows if row.split == "validation"])}
"""
