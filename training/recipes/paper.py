"""The networks as published."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import torch

from training.data.shards import Source
from training.data.windows import MAX_HORIZON
from training.networks.blocks import PIXEL_UNIT
from training.networks.task import Task
from training.objectives.losses import LikelihoodLoss, Loss, SpinLoss, SquaredLoss
from training.objectives.schedules import Plateau
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Member, Milestone, Recipe

T_TRAIN = 20


def tensorflows_rmsprop(groups: Iterable[dict[str, Any]], rate: float) -> torch.optim.RMSprop:
    """Create RMSProp as in TensorFlow 1.3, which the paper used.

    Its mean squares start at one, so steps grow slowly while gradients are small. In torch they
    start at zero: the first steps are ten times the learning rate, and rectifiers of VGG16 die
    (docs/experiments.md).
    """
    optimiser = torch.optim.RMSprop(groups, rate, alpha=0.9, eps=1e-5)
    for group in optimiser.param_groups:
        for parameter in group["params"]:
            state = {"step": torch.zeros(()), "square_avg": torch.ones_like(parameter)}
            optimiser.state[parameter] = state
    return optimiser


def paper_posnet() -> Recipe:
    """PosNet as published, on ellipsoidal bowls; requires ImageNet weights (``--imagenet``)."""
    return _published("posnet", SquaredLoss(), 1 / PIXEL_UNIT**2)


def paper_dispnet() -> Recipe:
    """DispNet as published, on ellipsoidal bowls; requires ImageNet weights (``--imagenet``)."""
    return _published("dispnet", SquaredLoss(), 1 / PIXEL_UNIT**2)


def paper_probnet() -> Recipe:
    """ProbNet as published, on ellipsoidal bowls; requires ImageNet weights (``--imagenet``).

    The paper sums the regulariser over the steps of a forecast, while the loss is a mean.
    """
    return _published("probnet", LikelihoodLoss(math.inf, regulariser=0.01 * T_TRAIN))


def paper_interpnet() -> Recipe:
    """InterpNet as published, on ellipsoidal bowls; requires ImageNet weights (``--imagenet``)."""
    return replace(
        _published("interpnet", SquaredLoss(), 1 / PIXEL_UNIT**2),
        task=Task(final_step=MAX_HORIZON - 1),
        curriculum=(Milestone(0, MAX_HORIZON),),
    )


def _published(variant: str, loss: Loss, weight: float = 1.0) -> Recipe:
    """Return the common configuration of the four recipes.

    The weights make squared losses those of lengths in halves of the frame.
    """
    name = f"paper-{variant}"
    return replace(
        one_ball(),
        name=name,
        preset="paper",
        members=(Member(name, variant, loss, weight),),
        spin_loss=SpinLoss(halving=math.inf, weight=1 / PIXEL_UNIT**2, squared=True),
        data=(DataShare(Source("ellipsoid"), 1800, 1.0, 200),),
        scenarios=("ellipsoid",),
        sequences=17_500_000,
        curriculum=(Milestone(0, T_TRAIN),),
        batch_size=50,
        learning_rate=1e-4,
        optimiser=tensorflows_rmsprop,
        schedule=Plateau,
        gradient_clip=math.inf,
    )
