"""Networks for a user's own set-up, from clips with tracks (paper, section 6)."""

from dataclasses import replace

from training.networks.task import Task
from training.objectives.losses import (
    DetachedNllLoss,
    DistanceLoss,
    LikelihoodLoss,
    PerceptionLoss,
    SpinLoss,
)
from training.recipes.recipe import Explicit, Member, Milestone, Recipe

T_TRAIN, T_GEN = 15, 30
"""Horizons of the paper's real footage. Training extends to T_gen."""


def setup(objects: int) -> Recipe:
    """FieldNet for clips with tracks, preferably from weights of a simulation (``--init``).

    Tracks contain no heights, ground or spin, so these remain latent variables. The perception is
    trained first, then the whole network.
    """
    name = f"setup-{objects}"
    likelihood = LikelihoodLoss(halving=15, regulariser=0.0, outlier=5.0)
    loss = DetachedNllLoss(DistanceLoss(halving=15, rounding=0.1), likelihood, weight=0.2)
    horizons = (Milestone(0, 1), Milestone(0.15, 2), Milestone(0.5, T_TRAIN), Milestone(0.8, T_GEN))
    return Recipe(
        name=f"setup-{objects}-balls" if objects > 1 else "setup-one-ball",
        preset="field",
        members=(Member(name, "fieldnet", loss),),
        spin_loss=SpinLoss(),  # nothing, for nothing is said of spin
        data=(),
        scenarios=(),
        task=Task(objects, angular_velocity=False),
        sequences=32_000,
        curriculum=horizons,
        explicit=Explicit(PerceptionLoss(), None, true_state_windows=0, curriculum=horizons),
        learning_rate=1e-3,
    )


def setup_seeing(objects: int) -> Recipe:
    """Train only the perception of a network from :func:`setup` (``--init``).

    Without rollouts, perception learns several times as fast, which several similar balls need.
    """
    recipe = setup(objects)
    assert recipe.explicit is not None
    horizons = (Milestone(0, 1),)
    return replace(
        recipe,
        name=f"{recipe.name}-seeing",
        curriculum=horizons,
        explicit=replace(recipe.explicit, curriculum=horizons),
        frozen=("rolling.", "first_covariance."),
        average_decay=0.995,
    )


def setup_continued(objects: int) -> Recipe:
    """Continue the training of perception and motion together (``--init``)."""
    recipe = setup(objects)
    assert recipe.explicit is not None
    horizons = (Milestone(0, T_TRAIN), Milestone(0.5, T_GEN))
    return replace(
        recipe,
        name=f"{recipe.name}-continued",
        sequences=24_000,
        curriculum=horizons,
        explicit=replace(recipe.explicit, curriculum=horizons),
        learning_rate=5e-4,
        seed=2,
    )
