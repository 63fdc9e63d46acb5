"""A study: its rows, measured one by one and kept as soon as they are."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from training.evaluation.evaluate import measured_at
from training.evaluation.paper import published
from training.objectives.metrics import Forecasts
from training.reporting.results import Cell, Curve, Results, curve_of
from training.studies.rows import Effort, Row
from training.studies.subject import FixedScenes, Subject


@dataclass(frozen=True)
class Study:
    """A table of the paper.

    Attributes
    ----------
    name
        As ``python -m training study`` knows it, and the name of its page in ``docs/results``.
    by_scenes
        Whether it compares scenes rather than methods: a line of its table is a subject.
    """

    name: str
    title: str
    caption: str
    subjects: tuple[Subject, ...]
    rows: Callable[[], tuple[Row, ...]]
    by_scenes: bool = False

    def run(self, file: Path, scenes: int, effort: Effort, methods: Iterable[str]) -> Iterator[str]:
        """Train and measure the rows that ``file`` lacks; yield what has been done.

        Parameters
        ----------
        file
            Results, which are written after every row.
        methods
            Rows to measure; with none, all of them.
        """
        wanted = set(methods)
        rows = self.rows()
        unknown = wanted - {row.method for row in rows}
        if unknown:
            known = ", ".join(row.method for row in rows)
            raise ValueError(f"{self.name} has no row {sorted(unknown)}; its rows: {known}")
        for subject in self.subjects:
            test = None
            for row in rows:
                if not row.fits(subject) or (wanted and row.method not in wanted):
                    continue
                if _known(Results.read(file), self.name, subject, row, scenes, effort):
                    continue
                test = test or FixedScenes(subject, "test", scenes, effort.workers)
                made = row.forecasts(test, effort)
                cells, curve = measured(self.name, subject, row, made, effort)
                Results.read(file).with_row(cells, curve).write(file)
                at = cells[-1]
                yield f"{subject.name}, {row.method}: {at.position_error_px:.2f} px at {at.at}"


def measured(
    study: str, subject: Subject, row: Row, made: Forecasts, effort: Effort
) -> tuple[list[Cell], Curve]:
    """Measure a row at the moments that are compared, and its error over time."""
    cells: list[Cell] = []
    reached = {at: T for at, T in subject.moments.items() if made.positions.shape[2] >= T}
    figures_at = measured_at(made, reached.values())
    for at, horizon in reached.items():
        condition = subject.condition
        paper = published(subject.scenario, subject.objects, row.method, at, condition)
        cell = Cell(
            scenario=subject.scenario,
            objects=subject.objects,
            method=row.method,
            variant=row.method,
            at=at,
            **figures_at[horizon]._asdict(),
            test_sequences=len(made.positions),
            training_sequences=row.trained_on(effort),
            paper_px=None if paper is None else paper.position_error_px,
            study=study,
            condition=condition,
        )
        cells.append(cell)
    curve = curve_of(subject.scenario, subject.objects, row.method, None, made.errors_px())
    return cells, replace(curve, study=study, condition=subject.condition)


def _known(
    results: Results, study: str, subject: Subject, row: Row, scenes: int, effort: Effort
) -> bool:
    """Whether a row has been measured with as much training, and as many scenes if with all."""
    wanted = (study, subject.scenario, subject.objects, subject.condition, row.method)
    return any(
        (cell.study, cell.scenario, cell.objects, cell.condition, cell.method) == wanted
        and _enough(cell.training_sequences or 0, row, effort)
        and (cell.test_sequences >= scenes or subject.condition != "")
        for cell in results.cells
    )


def _enough(sequences: int, row: Row, effort: Effort) -> bool:
    """Whether a row has seen what it would now; more of it is as good where it learns."""
    wanted = row.trained_on(effort) or 0
    return sequences >= wanted if row.learns else sequences == wanted
