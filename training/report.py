"""Writes the README's table of results from the manifests of the committed models."""

from collections.abc import Sequence
from pathlib import Path

from rollcast.manifest import MANIFEST_FILE, Manifest, MetricRow
from rollcast.scene import SCENARIOS, Scenario

BEGIN = "<!-- results: python -m training report -->"
END = "<!-- end of results -->"


def committed(models: Path) -> list[Manifest]:
    """Manifests of the default versions under ``models``, by name."""
    found = (Manifest.read(path) for path in sorted(models.glob(f"*/*/{MANIFEST_FILE}")))
    return [manifest for manifest in found if manifest.default]


def with_results(text: str, manifests: Sequence[Manifest]) -> str:
    """Replace what stands between the marks of ``text`` by the table of ``manifests``.

    Raises
    ------
    ValueError
        When the text lacks a mark.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the text lacks {BEGIN!r} or {END!r}")
    return f"{before}{BEGIN}\n\n{results_table(manifests)}\n\n{END}{after}"


def results_table(manifests: Sequence[Manifest]) -> str:
    """Errors on the test split at every reported horizon, baselines last, as Markdown."""
    horizons = sorted({row.horizon for manifest in manifests for row in manifest.metrics})
    names = [*(manifest.name for manifest in manifests), "stays put", "line"]
    lines = [
        f"| test scenes | {' | '.join(names)} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for scenario in SCENARIOS:
        for horizon in horizons:
            rows = [_row(manifest, scenario, horizon) for manifest in manifests]
            first = next((row for row in rows if row is not None), None)
            if first is not None:
                cells = [_error(row) for row in rows]
                cells += [_number(first.stays_put_px), _number(first.line_px)]
                label = f"{scenario}, T={horizon} ({first.sequences})"
                lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _row(manifest: Manifest, scenario: Scenario, horizon: int) -> MetricRow | None:
    wanted = ("test", scenario, horizon)
    rows = (row for row in manifest.metrics if (row.split, row.scenario, row.horizon) == wanted)
    return next(rows, None)


def _error(row: MetricRow | None) -> str:
    return "-" if row is None else _number(row.position_error_px)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
