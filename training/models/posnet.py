"""PosNet: positions read directly from every state (paper, section 3.2)."""

from training.models.blocks import CompactEncoder, ConvTransition, SpatialReadout
from training.models.predictor import DirectMotion, PointOutput, Predictor


def compact_posnet(frames: int, objects: int, *, angular_velocity: bool) -> Predictor:
    """PosNet in the compact preset: an 8 x 8 x 128 state with spatial read-outs."""
    channels = 128
    return Predictor(
        encoder=CompactEncoder(frames, objects, channels),
        transition=ConvTransition(channels, 128),
        motion=DirectMotion(SpatialReadout(channels, 2, hidden=96, relative=True)),
        output=PointOutput(),
        spin=SpatialReadout(channels, 3) if angular_velocity else None,
    )
