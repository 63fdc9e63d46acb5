"""Pages of the studies: each table with our figure and the paper's in the same cell."""

from collections.abc import Mapping, Sequence

from training.report import title
from training.results import Cell, Curve, Results
from training.studies.claims import CLAIMS, Verdict, verdicts
from training.studies.study import Study
from training.studies.subject import Subject

MISSING = "not measured"


def page(study: Study, results: Results) -> str:
    """Return ``docs/results/NAME.md``: the table, its pictures, and what the paper says of it."""
    own = results.of(study.name)
    parts = [
        f"<!-- Made by `python -m training study {study.name}`; do not edit. -->\n# {study.title}",
        study.caption,
        _table(study, own),
    ]
    if own.cells:
        parts.append(f"![Errors at both horizons]({bars_name(study)})")
    parts += [
        f"![Error over time, {title(subject.scenario, subject.objects)}]"
        f"({curves_name(study, subject)})"
        for subject in study.subjects
        if curves_of(own, subject)
    ]
    claimed = [claim for claim in CLAIMS if claim.study == study.name]
    if claimed:
        parts += ["## What the paper says of it", _claims(verdicts(claimed, own.cells))]
    return "\n\n".join(parts) + "\n"


def bars_name(study: Study) -> str:
    """Name the picture of a study's errors at both horizons."""
    return f"{study.name}-bars.png"


def curves_name(study: Study, subject: Subject) -> str:
    """Name the picture of a subject's errors over time."""
    return f"{study.name}-{subject.name}.png"


def curves_of(results: Results, subject: Subject) -> list[Curve]:
    """Return the errors over time that were measured on a subject."""
    wanted = (subject.scenario, subject.objects)
    return [curve for curve in results.curves if (curve.scenario, curve.objects) == wanted]


def _table(study: Study, results: Results) -> str:
    """Return a line a method; bold are the least errors of those that see only four frames."""
    cells = {(c.scenario, c.objects, c.method, c.at): c for c in results.cells}
    rows = study.rows()
    columns = [(subject, at) for subject in study.subjects for at in _moments(subject)]
    heads = [f"{title(s.scenario, s.objects)}, {at}" for s, at in columns]
    lines = [
        f"| method | given | {' | '.join(heads)} | trained on |",
        "|" + "---|" * (len(columns) + 3),
    ]
    best = {
        (subject, at): min(
            (
                cell.position_error_px
                for row in rows
                if not row.given_states and (cell := _found(cells, subject, row.method, at))
            ),
            default=None,
        )
        for subject, at in columns
    }
    for row in rows:
        found = [_found(cells, subject, row.method, at) for subject, at in columns]
        texts = [
            _cell(cell, bold=cell is not None and cell.position_error_px == best[column])
            for column, cell in zip(columns, found, strict=True)
        ]
        given = "states" if row.given_states else "frames"
        seen = "-" if row.sequences is None else f"{row.sequences:,}"
        lines.append(f"| {row.method} | {given} | {' | '.join(texts)} | {seen} |")
    return "\n".join(lines)


def _moments(subject: Subject) -> tuple[str, str]:
    return f"T={subject.trained_horizon}", f"T={subject.horizon}"


def _found(
    cells: Mapping[tuple[str, int, str, str], Cell], subject: Subject, method: str, at: str
) -> Cell | None:
    return cells.get((subject.scenario, subject.objects, method, at))


def _cell(cell: Cell | None, *, bold: bool) -> str:
    """Our error, angular velocity's in brackets, and the paper's after a stroke."""
    if cell is None:
        return MISSING
    ours = f"{cell.position_error_px:.1f}"
    if bold:
        ours = f"**{ours}**"
    if cell.angular_velocity_rmse is not None:
        ours += f" ({cell.angular_velocity_rmse:.1f})"
    paper = "-" if cell.paper_px is None else f"{cell.paper_px:.1f}"
    return f"{ours} / {paper}"


def _claims(found: Sequence[Verdict]) -> str:
    lines = ["| the paper's claim | here | figures |", "|---|---|---|"]
    lines += [f"| {one.claim.text} | {one.outcome} | {one.figures} |" for one in found]
    return "\n".join(lines)
