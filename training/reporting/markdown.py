"""Writes what people read of the results: the README's table and ``docs/results.md``."""

from collections.abc import Sequence

from rollcast.manifest import Manifest, MetricRow
from rollcast.scene import SCENARIOS, Scenario
from training.reporting.results import Measurement, Results

BEGIN = "<!-- results: python -m training report -->"
END = "<!-- end of results -->"


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
    return f"{before}{BEGIN}\n\n{overview(manifests)}\n\n{END}{after}"


def overview(manifests: Sequence[Manifest]) -> str:
    """Errors on the test split at the horizons that all models report, baselines last, as Markdown.

    Models of several balls have a table of their own each.
    """
    numbers = sorted({manifest.objects for manifest in manifests})
    groups = [[one for one in manifests if one.objects == number] for number in numbers]
    return "\n\n".join(_overview(group) for group in groups)


def _overview(manifests: Sequence[Manifest]) -> str:
    """Table of models that follow the same number of balls."""
    reported = [{row.horizon for row in manifest.metrics} for manifest in manifests]
    horizons = sorted(set[int].intersection(*reported))
    names = [*(manifest.name for manifest in manifests), "stays put", "line"]
    lines = [
        f"| {_balls(manifests[0].objects)}, test scenes | {' | '.join(names)} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for scenario in SCENARIOS:
        for horizon in horizons:
            rows = [_row(manifest, scenario, horizon) for manifest in manifests]
            first = next((row for row in rows if row is not None), None)
            if first is not None:
                errors = [None if row is None else row.position_error_px for row in rows]
                errors += [first.stays_put_px, first.line_px]
                label = f"{scenario}, T={horizon} ({first.sequences})"
                lines.append(f"| {label} | {' | '.join(_cell(error, 1) for error in errors)} |")
    return "\n".join(lines)


def page(results: Results, scenes: int) -> str:
    """Return ``docs/results.md``: a table a scenario and number of balls, and the pictures."""
    groups = sorted({(c.objects, SCENARIOS.index(c.scenario)) for c in results.cells})
    parts = [PREAMBLE.format(scenes=scenes)]
    for objects, index in groups:
        scenario = SCENARIOS[index]
        cells = [c for c in results.cells if (c.scenario, c.objects) == (scenario, objects)]
        parts += [f"## {title(scenario, objects)}", _table(cells)]
        parts.append(f"![Error over time](results/{picture_name(scenario, objects)})")
    parts += ["## Calibration", "![Share of truths inside the ellipses](results/calibration.png)"]
    parts += ["## Uncertainty over frames", "![Forecasts over frames](results/ellipses.png)"]
    return "\n\n".join(parts) + "\n"


def title(scenario: Scenario, objects: int, condition: str = "") -> str:
    """Name a group of results, with what is special about its scenes."""
    return ", ".join(filter(None, (scenario, _balls(objects), condition)))


def _balls(objects: int) -> str:
    return f"{objects} ball{'s' if objects > 1 else ''}"


def picture_name(scenario: Scenario, objects: int) -> str:
    """Name the picture of a group's errors over time."""
    return f"{scenario}-{objects}.png"


PREAMBLE = """<!-- Made by `python -m training evaluate --all`; do not edit. -->
# Results

Every committed model on the first {scenes} scenes of the test split, which training never saw, from
the fixed test start. 128-pixel units; T is the horizon, so the error is that of step T - 1; "worst
step" is the step with the largest mean error. "Stays put" rests at the true position of t = 0,
"line" goes through ten true positions (t = -3..6). Covariances are those that the service answers
with: the network's own times a scale per step fitted on validation scenes, or the covariance of its
validation residuals. The paper's networks each saw about 17 million sequences."""


def _table(cells: Sequence[Measurement]) -> str:
    lines = [
        "| method | T | error px | paper px | ang. vel. RMSE rad/s | neg. log likelihood | "
        "in 50 % | in 95 % | trained on |",
        "|" + "---|" * 9,
    ]
    for cell in cells:
        seen = "-" if cell.training_sequences is None else f"{cell.training_sequences:,}"
        columns = (
            cell.method, cell.at.removeprefix("T="),
            f"{cell.position_error_px:.2f} ± {cell.standard_error_px:.2f}",
            _cell(cell.paper_px, 1), _cell(cell.angular_velocity_rmse), _cell(cell.perplexity),
            _cell(cell.coverage_50), _cell(cell.coverage_95), seen,
        )  # fmt: skip
        lines.append(f"| {' | '.join(columns)} |")
    return "\n".join(lines)


def _row(manifest: Manifest, scenario: Scenario, horizon: int) -> MetricRow | None:
    wanted = ("test", scenario, horizon)
    rows = (row for row in manifest.metrics if (row.split, row.scenario, row.horizon) == wanted)
    return next(rows, None)


def _cell(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
