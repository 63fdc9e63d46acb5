"""The paper's studies, re-run on our data: which rows each table has, and how rows are measured."""

from collections.abc import Mapping

from training.studies.long_term import LONG_TERM, SEVERAL_BALLS
from training.studies.study import Study

STUDIES: Mapping[str, Study] = {study.name: study for study in (LONG_TERM, SEVERAL_BALLS)}
