"""A study: its rows, measured one by one and kept as soon as they are."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from training.evaluate import measured_at
from training.metrics import Forecasts
from training.paper import published
from training.results import Cell, Curve, Results, curve_of
from training.studies.rows import Row
from training.studies.subject import FixedScenes, Subject


@dataclass(frozen=True)
class Study:
    """A table of the paper.

    Attributes
    ----------
    name
        As ``python -m training study`` knows it, and the name of its page in ``docs/results``.
    """

    name: str
    title: str
    caption: str
    subjects: tuple[Subject, ...]
    rows: Callable[[], tuple[Row, ...]]

    def run(self, file: Path, scenes: int, workers: int, methods: Iterable[str]) -> Iterator[str]:
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
                if wanted and row.method not in wanted:
                    continue
                if _known(Results.read(file), self.name, subject, row, scenes):
                    continue
                test = test or FixedScenes(subject, "test", scenes, workers)
                made = row.forecasts(test, workers)
                cells, curve = measured(self.name, subject, row, made)
                Results.read(file).with_row(cells, curve).write(file)
                at = cells[-1]
                yield f"{subject.name}, {row.method}: {at.position_error_px:.2f} px at {at.at}"


def measured(study: str, subject: Subject, row: Row, made: Forecasts) -> tuple[list[Cell], Curve]:
    """Measure a row at T_train and T_gen, and its error over time."""
    cells: list[Cell] = []
    for horizon, figures in measured_at(made, (subject.trained_horizon, subject.horizon)).items():
        at = f"T={horizon}"
        paper = published(subject.scenario, subject.objects, row.method, at)
        cell = Cell(
            scenario=subject.scenario,
            objects=subject.objects,
            method=row.method,
            variant=row.method,
            at=at,
            **figures._asdict(),
            test_sequences=len(made.positions),
            training_sequences=row.sequences,
            paper_px=None if paper is None else paper.position_error_px,
            study=study,
        )
        cells.append(cell)
    curve = curve_of(subject.scenario, subject.objects, row.method, None, made.errors_px())
    return cells, replace(curve, study=study)


def _known(results: Results, study: str, subject: Subject, row: Row, scenes: int) -> bool:
    """Whether a row has been measured with its budget on as many scenes."""
    return any(
        (cell.study, cell.scenario, cell.objects, cell.method)
        == (study, subject.scenario, subject.objects, row.method)
        and cell.training_sequences == row.sequences
        and cell.test_sequences == scenes
        for cell in results.cells
    )
