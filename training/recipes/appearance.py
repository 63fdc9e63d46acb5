"""FieldNet's perception trained on varied appearances, beside those of the paper."""

from dataclasses import replace

from training.data.appearance_mixture import AppearanceMixture
from training.data.shards import Source, Variety
from training.objectives.losses import PerceptionLoss
from training.recipes.field import field_one_ball
from training.recipes.recipe import DataShare, Milestone, Recipe

VARIED = Variety()
OTHER_MATERIALS = Variety("other-materials", materials=True)

APPEARANCE_DATA = (
    DataShare(Source("hemisphere"), 1200, 0.12, 200),
    DataShare(Source("ellipsoid"), 2000, 0.24, 200),
    DataShare(Source("heightfield"), 1000, 0.28, 140),
    DataShare(Source("hemisphere", variety=VARIED), 1000, 0.10, 200),
    DataShare(Source("ellipsoid", variety=VARIED), 1500, 0.12, 200),
    DataShare(Source("heightfield", variety=VARIED), 800, 0.14, 140),
    DataShare(Source("hemisphere", variety=OTHER_MATERIALS), 400, 0.04, 200),
    DataShare(Source("ellipsoid", variety=OTHER_MATERIALS), 400, 0.04, 200),
    DataShare(Source("table"), 1000, 0.12, 140),
)
"""The paper's distributions, each beside a distribution that varies all scene parameters."""


def field_one_ball_appearance() -> Recipe:
    """Train FieldNet's perception on varied appearances (``--init`` with a trained network).

    The motion is frozen; rollouts follow at the end, as in ``field-one-ball-seeing``. The
    covariance must be trained afterwards.
    """
    recipe = field_one_ball()
    assert recipe.explicit is not None
    return replace(
        recipe,
        name="field-one-ball-appearance",
        preset="zoomed",
        data=APPEARANCE_DATA,
        sequences=192_000,
        curriculum=(Milestone(0, 1), Milestone(0.98, 1), Milestone(1, 20)),
        explicit=replace(
            recipe.explicit,
            perception=PerceptionLoss(within_reach=True),
            motion=None,
            true_state_windows=0,
            curriculum=(Milestone(0, 1),),
        ),
        frozen=("rolling.", "first_covariance."),
        earlier_horizon=40,
        learning_rate=8e-4,
        appearances=AppearanceMixture(),
        seed=7,
    )
