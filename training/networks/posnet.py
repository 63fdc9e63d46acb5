"""PosNet: positions read directly from every state (paper, section 3.2)."""

from training.networks.blocks import SpatialReadout
from training.networks.recurrent import DirectMotion, Head, PointOutput


def compact_head(channels: int) -> Head:
    """Build a two-layer read-out of the position from every state."""
    readout = SpatialReadout(channels, 2, hidden=96, relative=True)
    return Head(DirectMotion(readout), PointOutput())
