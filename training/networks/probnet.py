"""ProbNet: a bivariate Gaussian whose parameters move by increments (paper, section 3.3)."""

import torch

from training.networks.blocks import SpatialReadout
from training.networks.recurrent import GaussianOutput, Head, IncrementalMotion, logit_of_variance

FIRST_VARIANCE_PX2 = 2.0
"""Variance that an untrained network starts from."""


def compact_head(channels: int) -> Head:
    """Build a first Gaussian of its own, then one-layer increments of its five parameters."""
    first = SpatialReadout(channels, 5, hidden=96, relative=True)
    bias = first.proposals.bias
    assert bias is not None
    with torch.no_grad():
        bias[3:5] = logit_of_variance(FIRST_VARIANCE_PX2)
    return Head(IncrementalMotion(first, increment=SpatialReadout(channels, 5)), GaussianOutput())
