"""The compact preset: the paper's networks with a smaller encoder."""

from dataclasses import replace

from rollcast.scene import SMALL_RADIUS_M
from training.data.shards import Source
from training.networks.task import Task
from training.objectives.losses import DistanceLoss, LikelihoodLoss, SpinLoss
from training.recipes.recipe import DataShare, Member, Milestone, Recipe

ONE_BALL_DATA = (
    DataShare(Source("hemisphere"), 1200, 0.18, 200),
    DataShare(Source("ellipsoid"), 1800, 0.40, 200),
    DataShare(Source("heightfield"), 1200, 0.38, 120),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 200, 0.02, 200),
)
"""Three scenarios at the default radius, and a few small balls.

Ellipsoids, which include hemispheres, and heightfields have the largest errors.
"""


def one_ball() -> Recipe:
    """PosNet, DispNet and ProbNet for one ball in all scenarios, from random weights.

    Early steps of the rollout have larger weights, because a plain mean reduces their precision.
    """
    return Recipe(
        name="one-ball",
        preset="compact",
        members=extrapolating(suffix=""),
        spin_loss=SpinLoss(halving=8),
        data=ONE_BALL_DATA,
        scenarios=("hemisphere", "ellipsoid", "heightfield"),
        task=Task(),
        sequences=280_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.35, 10), Milestone(0.65, 20)),
    )


def one_ball_interpolation() -> Recipe:
    """InterpNet for one ball in all scenarios, with the frame of step 39."""
    return replace(
        one_ball(),
        name="one-ball-interpolation",
        members=(interpolating(suffix=""),),
        sequences=200_000,
        curriculum=(Milestone(0.0, 10), Milestone(0.3, 20), Milestone(0.6, 40)),
        task=Task(final_step=39),
    )


def several_balls(objects: int) -> Recipe:
    """PosNet, DispNet and ProbNet for two or three balls in ellipsoidal bowls."""
    return replace(
        one_ball(),
        name=f"{objects}-balls",
        members=extrapolating(suffix=f"-{objects}"),
        data=(DataShare(Source("ellipsoid", objects), 1500, 1.0, 200),),
        scenarios=("ellipsoid",),
        task=Task(objects),
        sequences=200_000,
        curriculum=(Milestone(0.1, 2), Milestone(0.3, 8), Milestone(0.6, 15)),
    )


def several_balls_interpolation(objects: int) -> Recipe:
    """InterpNet for two or three balls, with the frame of step 29."""
    return replace(
        several_balls(objects),
        name=f"{objects}-balls-interpolation",
        members=(interpolating(suffix=f"-{objects}"),),
        curriculum=(Milestone(0.0, 8), Milestone(0.3, 15), Milestone(0.6, 30)),
        task=Task(objects, final_step=29),
    )


def extrapolating(suffix: str) -> tuple[Member, ...]:
    """Networks of four frames; the suffix distinguishes their exported models."""
    return (
        Member(f"posnet{suffix}", "posnet", DistanceLoss(halving=8)),
        Member(f"dispnet{suffix}", "dispnet", DistanceLoss(halving=8), weight=0.5),
        Member(f"probnet{suffix}", "probnet", LikelihoodLoss(halving=8)),
    )


def interpolating(suffix: str) -> Member:
    """Return the network with a final frame; its errors are largest in the middle."""
    return Member(f"interpnet{suffix}", "interpnet", DistanceLoss(halving=40))
