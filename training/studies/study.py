"""A study: its rows, measured one by one and kept as soon as they are."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from training.evaluation.evaluate import Measured, measured_at, rounded
from training.evaluation.paper import published
from training.reporting.results import Curve, Measurement, Results, curve_of
from training.studies.benchmark_case import BenchmarkCase, FixedScenes
from training.studies.rows import Row, RowResult, StudyBudget


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
        """Train and measure the rows that ``file`` lacks; yield progress.

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
                trained = range(1, budget.seeds + 1) if row.learns else (1,)
                outcomes = [row.measure(test, replace(budget, seed=seed)) for seed in trained]
                cells, curve = measured(self.name, case, row, outcomes, budget)
                Results.read(file).with_row(cells, curve).write(file)
                at = cells[-1]
                yield f"{case.name}, {row.method}: {at.position_error_px:.2f} px at {at.at}"


def measured(
    study: str, case: BenchmarkCase, row: Row, outcomes: Sequence[RowResult], budget: StudyBudget
) -> tuple[list[Measurement], Curve]:
    """Measure a row at the moments that are compared, and its error over time.

    Parameters
    ----------
    outcomes
        Of trainings that differ in their seed. Figures are their means; the curve is the first's.
    """
    cells: list[Measurement] = []
    made = outcomes[0].forecasts
    reached = {at: T for at, T in case.moments.items() if made.positions.shape[2] >= T}
    figures_at = [measured_at(one.forecasts, reached.values()) for one in outcomes]
    ends = [one.converged for one in outcomes]
    for at, horizon in reached.items():
        condition = case.condition
        paper = published(case.scenario, case.objects, row.paper_method, at, condition)
        figures = [of_seed[horizon] for of_seed in figures_at]
        errors = [one.position_error_px for one in figures]
        cell = Measurement(
            scenario=case.scenario,
            objects=case.objects,
            method=row.method,
            variant=row.method,
            at=at,
            **_mean(figures)._asdict(),
            test_sequences=len(made.positions),
            training_sequences=row.trained_on(budget),
            paper_px=None if paper is None else paper.position_error_px,
            study=study,
            condition=condition,
            optimiser_steps=outcomes[0].optimiser_steps,
            converged=None if None in ends else all(ends),
            seeds=len(outcomes),
            seed_spread_px=rounded(max(errors) - min(errors)) if len(errors) > 1 else None,
        )
        cells.append(cell)
    curve = curve_of(case.scenario, case.objects, row.method, None, made.errors_px())
    return cells, replace(curve, study=study, condition=case.condition)


def _mean(figures: Sequence[Measured]) -> Measured:
    """Return the mean of every figure; figures that the first lacks are missing in all."""
    means = {
        name: rounded(sum(getattr(one, name) for one in figures) / len(figures))
        for name, first in figures[0]._asdict().items()
        if first is not None
    }
    return figures[0]._replace(**means)


def _known(
    results: Results, study: str, case: BenchmarkCase, row: Row, scenes: int, budget: StudyBudget
) -> bool:
    """Whether a row has been measured with as much training, and as many scenes if with all."""
    wanted = (study, case.scenario, case.objects, case.condition, row.method)
    return any(
        (cell.study, cell.scenario, cell.objects, cell.condition, cell.method) == wanted
        and _enough(cell.training_sequences or 0, row, budget)
        and (cell.seeds >= budget.seeds or not row.learns)
        and (cell.test_sequences >= scenes or case.condition != "")
        for cell in results.cells
    )


def _enough(sequences: int, row: Row, budget: StudyBudget) -> bool:
    """Return whether a stored row has its number of sequences; trained rows may have more."""
    wanted = row.trained_on(budget) or 0
    return sequences >= wanted if row.learns else sequences == wanted
