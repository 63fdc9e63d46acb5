"""Presets by name: each composes every variant from its own parts (design, section 4)."""

from collections.abc import Mapping
from typing import Protocol

from training.models.compact import compact_family
from training.models.fieldnet import field_family, zoomed_family
from training.models.paper import paper_family
from training.models.predictor import Family
from training.models.sighted import sighted_family
from training.models.task import Task


class Preset(Protocol):
    """Makes untrained networks, by name, of some variants: they share all but their heads."""

    def __call__(self, variants: Mapping[str, str], task: Task) -> Family:
        """Make a family.

        Parameters
        ----------
        variants
            Variant of every network by the network's name.
        """
        ...


PRESETS: Mapping[str, Preset] = {
    "compact": compact_family,
    "paper": paper_family,
    "field": field_family,
    "zoomed": zoomed_family,
    "sighted": sighted_family,
}
