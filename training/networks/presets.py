"""Presets by name: each composes every variant from its own parts (decision 0012)."""

from collections.abc import Mapping
from typing import Protocol

from training.networks.compact import compact_family
from training.networks.fieldnet import field_family, zoomed_family
from training.networks.perception_state import perception_state_family
from training.networks.recurrent import Family
from training.networks.task import Task
from training.networks.vgg import paper_family


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
    "perception_init": perception_state_family,
}
