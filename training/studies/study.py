"""A study: its rows, measured one by one and kept as soon as they are."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from training.evaluation.evaluate import measured_at
from training.evaluation.paper import published
from training.objectives.metrics import Forecasts
from training.reporting.results import Curve, Measurement, Results, curve_of
from training.studies.benchmark_case import BenchmarkCase, FixedScenes
from training.studies.rows import Row, StudyBudget


@dataclass(frozen=True)
class Study:
    """A table of the paper.

    Attributes
    ----------
    name
        As ``python -m training study`` knows it, and the name of its page in ``docs/results``.
    by_scenes
        Whether it compares scenes rather than methods: a line of its table is a case.
    """

    name: str
    title: str
    caption: str
    cases: tuple[BenchmarkCase, ...]
    rows: Callable[[], tuple[Row, ...]]
    by_scenes: bool = False

    def run(
        self, file: Path, scenes: int, budget: StudyBudget, methods: Iterable[str]
    ) -> Iterator[str]:
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
        for case in self.cases:
            test = None
            for row in rows:
                if not row.fits(case) or (wanted and row.method not in wanted):
                    continue
                if _known(Results.read(file), self.name, case, row, scenes, budget):
                    continue
                test = test or FixedScenes(case, "test", scenes, budget.workers)
                made = row.forecasts(test, budget)
                cells, curve = measured(self.name, case, row, made, budget)
                Results.read(file).with_row(cells, curve).write(file)
                at = cells[-1]
                yield f"{case.name}, {row.method}: {at.position_error_px:.2f} px at {at.at}"


def measured(
    study: str, case: BenchmarkCase, row: Row, made: Forecasts, budget: StudyBudget
) -> tuple[list[Measurement], Curve]:
    """Measure a row at the moments that are compared, and its error over time."""
    cells: list[Measurement] = []
    reached = {at: T for at, T in case.moments.items() if made.positions.shape[2] >= T}
    figures_at = measured_at(made, reached.values())
    for at, horizon in reached.items():
        condition = case.condition
        paper = published(case.scenario, case.objects, row.method, at, condition)
        cell = Measurement(
            scenario=case.scenario,
            objects=case.objects,
            method=row.method,
            variant=row.method,
            at=at,
            **figures_at[horizon]._asdict(),
            test_sequences=len(made.positions),
            training_sequences=row.trained_on(budget),
            paper_px=None if paper is None else paper.position_error_px,
            study=study,
            condition=condition,
        )
        cells.append(cell)
    curve = curve_of(case.scenario, case.objects, row.method, None, made.errors_px())
    return cells, replace(curve, study=study, condition=case.condition)


def _known(
    results: Results, study: str, case: BenchmarkCase, row: Row, scenes: int, budget: StudyBudget
) -> bool:
    """Whether a row has been measured with as much training, and as many scenes if with all."""
    wanted = (study, case.scenario, case.objects, case.condition, row.method)
    return any(
        (cell.study, cell.scenario, cell.objects, cell.condition, cell.method) == wanted
        and _enough(cell.training_sequences or 0, row, budget)
        and (cell.test_sequences >= scenes or case.condition != "")
        for cell in results.cells
    )


def _enough(sequences: int, row: Row, budget: StudyBudget) -> bool:
    """Whether a row has seen what it would now; more of it is as good where it learns."""
    wanted = row.trained_on(budget) or 0
    return sequences >= wanted if row.learns else sequences == wanted
