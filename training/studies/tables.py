"""Pages of the studies: each table with our figure and the paper's in the same cell."""

from collections.abc import Sequence

from training.reporting.markdown import title
from training.reporting.results import Curve, Measurement, Results
from training.studies.benchmark_case import BenchmarkCase
from training.studies.claims import CLAIMS, Verdict, verdicts
from training.studies.rows import Row
from training.studies.study import Study

MISSING = "not measured"


def page(study: Study, results: Results) -> str:
    """Return ``docs/results/NAME.md``: the table, its pictures, and what the paper says of it."""
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
        parts += ["## What the paper says of it", _claims(verdicts(claimed, own.cells))]
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
    """Return a line a method; bold are the least errors of those that see frames."""
    rows = study.rows()
    columns = [(case, at) for case in study.cases for at in case.moments]
    heads = [f"{_scenes(case)}, {at}" for case, at in columns]
    lines = [
        f"| method | given | {' | '.join(heads)} | trained on |",
        "|" + "---|" * (len(columns) + 3),
    ]
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
        lines.append(f"| {row.method} | {given} | {' | '.join(texts)} | {_seen(results, row)} |")
    return "\n".join(lines)


def _seen(results: Results, row: Row) -> str:
    """Training sequences of a line's cells, the fewest and the most where they differ."""
    of_row = [
        cell.training_sequences
        for cell in results.cells
        if cell.method == row.method and cell.training_sequences
    ]
    if not of_row:
        return "-"
    return " to ".join(f"{number:,}" for number in sorted({min(of_row), max(of_row)}))


def _table_by_scenes(study: Study, results: Results) -> str:
    """Return a line a case, with every method's errors."""
    methods = [row.method for row in study.rows()]
    lines = [
        f"| scenes | number | {' | '.join(methods)} |",
        "|" + "---|" * (len(methods) + 2),
    ]
    for case in study.cases:
        cells = [[_found(results, case, method, at) for at in case.moments] for method in methods]
        errors = [
            " / ".join(f"{cell.position_error_px:.1f}" if cell else MISSING for cell in of_method)
            for of_method in cells
        ]
        number = next((str(cell.test_sequences) for row in cells for cell in row if cell), "-")
        lines.append(f"| {_scenes(case)} | {number} | {' | '.join(errors)} |")
    return "\n".join(lines)


def _scenes(case: BenchmarkCase) -> str:
    return title(case.scenario, case.objects, case.condition)


def _found(results: Results, case: BenchmarkCase, method: str, at: str) -> Measurement | None:
    wanted = (case.scenario, case.objects, case.condition, method, at)
    for cell in results.cells:
        if (cell.scenario, cell.objects, cell.condition, cell.method, cell.at) == wanted:
            return cell
    return None


def _cell(cell: Measurement | None, best: float | None) -> str:
    """Our error, angular velocity's in brackets, and the paper's after a stroke."""
    if cell is None:
        return MISSING
    ours = f"{cell.position_error_px:.1f}"
    if cell.position_error_px == best:
        ours = f"**{ours}**"
    if cell.angular_velocity_rmse is not None:
        ours += f" ({cell.angular_velocity_rmse:.1f})"
    paper = "-" if cell.paper_px is None else f"{cell.paper_px:.1f}"
    return f"{ours} / {paper}"


def _claims(found: Sequence[Verdict]) -> str:
    lines = ["| the paper's claim | here | figures |", "|---|---|---|"]
    lines += [f"| {one.claim.text} | {one.outcome} | {one.figures} |" for one in found]
    return "\n".join(lines)
