"""ProbNet: a bivariate Gaussian whose parameters move by increments (paper, section 3.3)."""

import torch

from training.models.blocks import CompactEncoder, ConvTransition, SpatialReadout
from training.models.predictor import (
    GaussianOutput,
    IncrementalMotion,
    Predictor,
    logit_of_variance,
)

FIRST_VARIANCE_PX2 = 2.0
"""Variance that an untrained network starts from."""


def compact_probnet(frames: int, objects: int, *, angular_velocity: bool) -> Predictor:
    """ProbNet in the compact preset: an 8 x 8 x 128 state with spatial read-outs."""
    channels = 128
    first = SpatialReadout(channels, 5, hidden=96, relative=True)
    bias = first.proposals.bias
    assert bias is not None
    with torch.no_grad():
        bias[3:5] = logit_of_variance(FIRST_VARIANCE_PX2)
    return Predictor(
        encoder=CompactEncoder(frames, objects, channels),
        transition=ConvTransition(channels, 128),
        motion=IncrementalMotion(first, increment=SpatialReadout(channels, 5)),
        output=GaussianOutput(),
        spin=SpatialReadout(channels, 3) if angular_velocity else None,
    )
