"""The compact preset: every variant over an 8 x 8 x 128 state (decision 0012)."""

from collections.abc import Callable, Mapping

from torch import nn

from training.networks import dispnet, interpnet, posnet, probnet
from training.networks.blocks import (
    CompactEncoder,
    ConvTransition,
    ObjectInteraction,
    SpatialReadout,
)
from training.networks.recurrent import Family, Head, RecurrentNetwork, SharedStateFamily
from training.networks.task import Task

CHANNELS = 128

HEADS: Mapping[str, Callable[[int], Head]] = {
    "posnet": posnet.compact_head,
    "dispnet": dispnet.compact_head,
    "probnet": probnet.compact_head,
    "interpnet": interpnet.compact_head,
}
"""Heads by variant."""


def compact_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make a family in the compact preset (see :class:`training.networks.presets.Preset`)."""
    encoder = CompactEncoder(task.frames, task.objects, CHANNELS)
    met = ObjectInteraction() if task.meetings else None
    transition = ConvTransition(CHANNELS, 128, met)
    return SharedStateFamily(composed(variants, encoder, transition, spin=task.angular_velocity))


def composed(
    variants: Mapping[str, str],
    encoder: nn.Module,
    transition: nn.Module,
    *,
    spin: bool,
    kind: type[RecurrentNetwork] = RecurrentNetwork,
) -> dict[str, RecurrentNetwork]:
    """Predictors of the variants over one state of CHANNELS, which encoder and transition make."""
    readout = SpatialReadout(CHANNELS, 3) if spin else None
    return {
        name: kind(encoder, transition, HEADS[variant](CHANNELS), readout)
        for name, variant in variants.items()
    }
