"""Presets by name: each composes every variant from its own parts (design, section 4)."""

from collections.abc import Mapping
from typing import Protocol

from training.models.compact import compact_family
from training.models.fieldnet import field_family
from training.models.paper import paper_family
from training.models.predictor import Family
from training.models.sighted import sighted_family


class Preset(Protocol):
    """Makes untrained networks, by name, of some variants: they share all but their heads."""

    def __call__(
        self,
        variants: Mapping[str, str],
        frames: int,
        objects: int,
        *,
        angular_velocity: bool,
        interaction: bool = True,
    ) -> Family:
        """Make a family.

        Parameters
        ----------
        variants
            Variant of every network by the network's name.
        frames
            Frames that the encoder reads: four, and the final one for InterpNet.
        interaction
            Whether several balls know of each other.
        """
        ...


PRESETS: Mapping[str, Preset] = {
    "compact": compact_family,
    "paper": paper_family,
    "field": field_family,
    "sighted": sighted_family,
}
