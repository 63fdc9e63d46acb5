"""Which seeds belong to which split: the one list that keeps training away from the test set.

Splits are by simulation. Seeds below 1,000,000 are left to users, so no scene that somebody asks
the service for by a small seed was trained on.
"""

from collections.abc import Mapping
from typing import Literal, TypeAlias

Split: TypeAlias = Literal["training", "validation", "test"]

FIRST_SEED: Mapping[Split, int] = {
    "training": 1_000_000,
    "validation": 2_000_000,
    "test": 3_000_000,
}
MAX_SCENES = 1_000_000
"""Room of every split: seeds FIRST_SEED .. FIRST_SEED + MAX_SCENES - 1."""


def seeds(split: Split, scenes: int) -> range:
    """Seeds of the first ``scenes`` scenes of a split."""
    if not 0 < scenes <= MAX_SCENES:
        raise ValueError(f"{scenes} scenes asked of a split that has 1 to {MAX_SCENES}")
    return range(FIRST_SEED[split], FIRST_SEED[split] + scenes)
