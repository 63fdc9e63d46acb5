"""DispNet: positions that move by increments (paper, section 3.2)."""

from training.networks.blocks import SpatialReadout
from training.networks.recurrent import Head, IncrementalMotion, PointOutput


def compact_head(channels: int) -> Head:
    """Build a first position of its own, then one-layer displacements."""
    first = SpatialReadout(channels, 2, hidden=96, relative=True)
    return Head(IncrementalMotion(first, increment=SpatialReadout(channels, 2)), PointOutput())
