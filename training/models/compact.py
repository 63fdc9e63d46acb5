"""The compact preset: every variant over an 8 x 8 x 128 state (design, section 4)."""

from collections.abc import Callable, Mapping

from training.models import dispnet, posnet, probnet
from training.models.blocks import CompactEncoder, ConvTransition, SpatialReadout
from training.models.predictor import Family, Head, Predictor

CHANNELS = 128

HEADS: Mapping[str, Callable[[int], Head]] = {
    "posnet": posnet.compact_head,
    "dispnet": dispnet.compact_head,
    "probnet": probnet.compact_head,
}
"""What tells the variants apart."""


def compact_family(
    variants: Mapping[str, str], frames: int, objects: int, *, angular_velocity: bool
) -> Family:
    """Untrained networks, by name, of some variants: they share all but their heads."""
    encoder = CompactEncoder(frames, objects, CHANNELS)
    transition = ConvTransition(CHANNELS, 128)
    spin = SpatialReadout(CHANNELS, 3) if angular_velocity else None
    return Family(
        {
            name: Predictor(encoder, transition, HEADS[variant](CHANNELS), spin)
            for name, variant in variants.items()
        }
    )
