"""Pages of the studies: each table with our figure and the paper's in the same cell."""

from collections.abc import Sequence

from rollcast.markdown import table
from training.evaluation.paper import published
from training.reporting.markdown import title
from training.reporting.results import Curve, Measurement, Results
from training.studies.benchmark_case import BenchmarkCase
from training.studies.claims import CLAIMS, Verdict, verdicts
from training.studies.rows import Row, paper_method
from training.studies.study import Study

MISSING = "not measured"


def page(study: Study, results: Results) -> str:
    """Return ``docs/results/NAME.md``: the table, its pictures and the paper's claims."""
    own = results.of(study.name)
    parts = [
        f"<!-- Made by `python -m training study {study.name}`; do not edit. -->\n# {study.title}",
        study.caption,
        _table_by_scenes(study, own) if study.by_scenes else _table(study, own),
    ]
    if own.cells:
        parts.append(f"![Errors at both horizons]({bars_name(study)})")
    parts += [
        f"![Error over time, {_scenes(case)}]({curves_name(study, case)})"
        for case in study.cases
        if curves_of(own, case) and not study.by_scenes
    ]
    claimed = [claim for claim in CLAIMS if claim.study == study.name]
    if claimed:
        parts += ["## Claims of the paper", _claims(verdicts(claimed, own.cells))]
    return "\n\n".join(parts) + "\n"


def bars_name(study: Study) -> str:
    """Name the picture of a study's errors at both horizons."""
    return f"{study.name}-bars.png"


def curves_name(study: Study, case: BenchmarkCase) -> str:
    """Name the picture of a case's errors over time."""
    return f"{study.name}-{case.source.name}.png"


def curves_of(results: Results, case: BenchmarkCase) -> list[Curve]:
    """Return the errors over time that were measured on a case."""
    wanted = (case.scenario, case.objects, case.condition)
    return [
        curve
        for curve in results.curves
        if (curve.scenario, curve.objects, curve.condition) == wanted
    ]


def _table(study: Study, results: Results) -> str:
    """Return one line per method; the least errors of methods from frames are bold."""
    rows = study.rows()
    columns = [(case, at) for case in study.cases for at in case.moments]
    heads = [f"{_scenes(case)}, {at}" for case, at in columns]
    lines: list[Sequence[str]] = []
    best = {
        (case, at): min(
            (
                cell.position_error_px
                for row in rows
                if not row.given_states and (cell := _found(results, case, row.method, at))
            ),
            default=None,
        )
        for case, at in columns
    }
    for row in {row.method: row for row in rows}.values():
        fitting = [one for one in rows if one.method == row.method]
        texts = [
            _cell(_found(results, case, row.method, at), best[case, at])
            if any(one.fits(case) for one in fitting)
            else "-"
            for case, at in columns
        ]
        given = "states" if row.given_states else "frames"
        about = f"{row.architecture} / {row.supervision}"
        lines.append((row.method, about, given, *texts, *_training(results, row)))
    ends = ("sequences", "optimiser steps", "trainings", "converged")
    return table(("method", "architecture / supervision", "given", *heads, *ends), lines)


def _training(results: Results, row: Row) -> tuple[str, str, str, str]:
    """Return sequences, steps, trainings of a line's cells, and in how many it has converged."""
    cells = [c for c in results.cells if c.method == row.method and c.training_sequences]
    if not cells:
        return "-", "-", "-", "-"
    if not row.learns:
        return _range([c.training_sequences for c in cells]), "-", "-", "-"
    ended = [cell.converged for cell in cells]
    said = "not tested" if set(ended) == {None} else f"{ended.count(True)} of {len(ended)} cells"
    return (
        _range([cell.training_sequences for cell in cells]),
        _range([cell.optimiser_steps for cell in cells]),
        _range([cell.seeds for cell in cells]),
        said,
    )


def _range(numbers: Sequence[int | None]) -> str:
    """Return the smallest and the largest of some numbers, one where they are equal."""
    known = [number for number in numbers if number is not None]
    if not known:
        return "not noted"
    return " to ".join(f"{number:,}" for number in sorted({min(known), max(known)}))


def _table_by_scenes(study: Study, results: Results) -> str:
    """Return a line a case, with every method's errors."""
    methods = [row.method for row in study.rows()]
    lines: list[Sequence[str]] = []
    for case in study.cases:
        cells = [[_found(results, case, method, at) for at in case.moments] for method in methods]
        errors = [
            " / ".join(f"{cell.position_error_px:.1f}" if cell else MISSING for cell in of_method)
            for of_method in cells
        ]
        numbers = [cell.test_sequences for row in cells for cell in row if cell]
        number = _range(numbers) if numbers else "-"
        lines.append((_scenes(case), number, *errors))
    return table(("scenes", "number", *methods), lines)


def _scenes(case: BenchmarkCase) -> str:
    return title(case.scenario, case.objects, case.condition)


def _found(results: Results, case: BenchmarkCase, method: str, at: str) -> Measurement | None:
    wanted = (case.scenario, case.objects, case.condition, method, at)
    for cell in results.cells:
        if (cell.scenario, cell.objects, cell.condition, cell.method, cell.at) == wanted:
            return cell
    return None


def _cell(cell: Measurement | None, best: float | None) -> str:
    """Error, its spread over seeds, angular velocity's, likelihood, and the paper's figures."""
    if cell is None:
        return MISSING
    ours = f"{cell.position_error_px:.1f}"
    if cell.position_error_px == best:
        ours = f"**{ours}**"
    if cell.seed_spread_px is not None:
        ours += f" ± {cell.seed_spread_px / 2:.1f}"
    if cell.angular_velocity_rmse is not None:
        ours += f" ({cell.angular_velocity_rmse:.1f})"
    if cell.nll_nats is not None:
        ours += f" [{cell.nll_nats:.1f} nats]"
    if cell.paper_px is None:
        return f"{ours} / -"
    place = (cell.scenario, cell.objects, paper_method(cell.method), cell.at, cell.condition)
    printed = published(*place)
    likelihood = None if printed is None else printed.nll_nats
    return f"{ours} / {cell.paper_px:.1f}" + (f" [{likelihood:.1f}]" if likelihood else "")


def _claims(found: Sequence[Verdict]) -> str:
    return table(
        ("the paper's claim", "here", "figures"),
        [(one.claim.text, one.outcome, one.figures) for one in found],
    )
