"""The paper's studies, re-run on our data: which rows each table has, and how rows are measured."""

from collections.abc import Mapping

from training.studies.ablations import COLLISIONS, INTERPOLATION, MODULE, SUPERVISION, TEXTURE
from training.studies.conditions import DIFFICULTY, UNUSUAL
from training.studies.long_term import LONG_TERM, SEVERAL_BALLS
from training.studies.study import Study

_ALL = (
    LONG_TERM,
    TEXTURE,
    SEVERAL_BALLS,
    MODULE,
    COLLISIONS,
    INTERPOLATION,
    SUPERVISION,
    DIFFICULTY,
    UNUSUAL,
)
STUDIES: Mapping[str, Study] = {study.name: study for study in _ALL}
"""Studies by name."""
