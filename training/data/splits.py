"""Seeds of the splits: the only list, so that no training reads a test scene.

Splits are by simulation. Seeds below 1,000,000 are left to users: no scene that the service
simulates for a small seed was trained on.
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
"""Size of every split: seeds FIRST_SEED .. FIRST_SEED + MAX_SCENES - 1."""


def seeds(split: Split, scenes: int) -> range:
    """Return the seeds of the first ``scenes`` scenes of a split.

    Raises
    ------
    ValueError
        If ``scenes`` is not in 1 to ``MAX_SCENES``.
    """
    if not 0 < scenes <= MAX_SCENES:
        raise ValueError(f"a split has 1 to {MAX_SCENES} scenes, not {scenes}")
    return range(FIRST_SEED[split], FIRST_SEED[split] + scenes)
