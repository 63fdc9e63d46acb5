"""The networks as published."""

import math
from dataclasses import replace

import torch

from training.losses import SpinLoss, SquaredLoss
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Member, Milestone, Recipe
from training.schedules import Plateau
from training.simulate import Source


def paper_posnet() -> Recipe:
    """PosNet as published, on ellipsoidal bowls; give it ImageNet's weights (``--imagenet``)."""
    return replace(
        one_ball(),
        name="paper-posnet",
        preset="paper",
        members=(Member("paper-posnet", "posnet", SquaredLoss()),),
        spin_loss=SpinLoss(halving=math.inf, weight=1, squared=True),
        data=(DataShare(Source("ellipsoid"), 1800, 1.0, 200),),
        scenarios=("ellipsoid",),
        sequences=17_500_000,
        curriculum=(Milestone(0, 20),),
        batch_size=50,
        learning_rate=1e-4,
        optimiser=torch.optim.RMSprop,
        schedule=Plateau,
        gradient_clip=math.inf,
    )
