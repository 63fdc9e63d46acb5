"""A first experiment: a model for the service, trained in a few minutes on one core."""

from dataclasses import replace

from training.data.shards import SHARD_SCENES, Source
from training.objectives.losses import DistanceLoss
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Member, Milestone, Recipe


def tiny() -> Recipe:
    """PosNet for one ball in the hemisphere, from few scenes, in a few minutes."""
    return replace(
        one_ball(),
        name="tiny",
        members=(Member("tiny", "posnet", DistanceLoss(halving=8)),),
        data=(DataShare(Source("hemisphere"), 4 * SHARD_SCENES, 1.0, 200),),
        scenarios=("hemisphere",),
        sequences=3_200,
        curriculum=(Milestone(0, 2), Milestone(0.6, 10)),
        average_decay=0.98,
        validation_scenes=SHARD_SCENES,
    )
