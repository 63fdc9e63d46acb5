"""InterpNet: DispNet that also sees the final frame and decodes it (paper, section 5.2)."""

from training.networks import dispnet
from training.networks.blocks import SpatialReadout
from training.networks.recurrent import Head


def compact_head(channels: int) -> Head:
    """Build DispNet's head and a read-out of the final position from s_0."""
    final = SpatialReadout(channels, 2, hidden=96, relative=True)
    return dispnet.compact_head(channels)._replace(final=final)
