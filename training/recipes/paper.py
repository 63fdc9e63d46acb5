"""The networks as published."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import torch

from training.data.shards import Source
from training.networks.blocks import PIXEL_UNIT
from training.objectives.losses import SpinLoss, SquaredLoss
from training.objectives.schedules import Plateau
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Member, Milestone, Recipe


def tensorflows_rmsprop(groups: Iterable[dict[str, Any]], rate: float) -> torch.optim.RMSprop:
    """Make RMSProp as TensorFlow 1.3 has it, which the paper used.

    Its mean squares begin with ones, so while gradients are small its steps grow slowly. Torch's
    begin with zeros: the first steps are ten times the rate, and VGG16's rectifiers die of them
    (docs/experiments.md).
    """
    optimiser = torch.optim.RMSprop(groups, rate, alpha=0.9, eps=1e-5)
    for group in optimiser.param_groups:
        for parameter in group["params"]:
            state = {"step": torch.zeros(()), "square_avg": torch.ones_like(parameter)}
            optimiser.state[parameter] = state
    return optimiser


def paper_posnet() -> Recipe:
    """PosNet as published, on ellipsoidal bowls; give it ImageNet's weights (``--imagenet``).

    The weights make its losses those of lengths in halves of the frame.
    """
    weight = 1 / PIXEL_UNIT**2
    return replace(
        one_ball(),
        name="paper-posnet",
        preset="paper",
        members=(Member("paper-posnet", "posnet", SquaredLoss(), weight),),
        spin_loss=SpinLoss(halving=math.inf, weight=weight, squared=True),
        data=(DataShare(Source("ellipsoid"), 1800, 1.0, 200),),
        scenarios=("ellipsoid",),
        sequences=17_500_000,
        curriculum=(Milestone(0, 20),),
        batch_size=50,
        learning_rate=1e-4,
        optimiser=tensorflows_rmsprop,
        schedule=Plateau,
        gradient_clip=math.inf,
    )
