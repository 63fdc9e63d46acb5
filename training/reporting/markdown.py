"""Markdown of the results: the README's table and ``docs/results.md``."""

from collections.abc import Sequence

from rollcast.manifest import Manifest, MetricRow
from rollcast.markdown import table
from rollcast.scene import SCENARIOS, Scenario
from training.evaluation.paper import CONSTANT_POSITION, LINEAR_EXTRAPOLATION, published
from training.reporting.results import Measurement, Results

BEGIN = "<!-- results: python -m training report -->"
END = "<!-- end of results -->"


def with_results(text: str, manifests: Sequence[Manifest]) -> str:
    """Replace the text between the marks of ``text`` by the table of ``manifests``.

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


README_MODELS = ("fieldnet", "fieldnet-interpolation", "posnet")
README_HORIZON = 20


def overview(manifests: Sequence[Manifest]) -> str:
    """Errors of one ball at T = 20 on the test split, one row per scenario, as Markdown."""
    models = [one for name in README_MODELS for one in manifests if one.name == name]
    lines: list[Sequence[str]] = []
    for scenario in SCENARIOS:
        rows = [_row(manifest, scenario, README_HORIZON) for manifest in models]
        first = next((row for row in rows if row is not None), None)
        if first is None:
            continue
        paper = published(scenario, 1, "posnet", f"T={README_HORIZON}")
        errors = [None if row is None else row.position_error_px for row in rows]
        errors += [
            first.constant_position_px,
            first.linear_extrapolation_px,
            paper and paper.position_error_px,
        ]
        lines.append((f"{scenario} ({first.sequences})", *(_cell(error, 1) for error in errors)))
    names = [manifest.name for manifest in models]
    heads = [*names, CONSTANT_POSITION, LINEAR_EXTRAPOLATION, "PosNet in the paper"]
    return table((f"error in px at T = {README_HORIZON}", *heads), lines)


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
    """Return the title of a group of results, with the condition of its scenes."""
    return ", ".join(filter(None, (scenario, _balls(objects), condition)))


def _balls(objects: int) -> str:
    return f"{objects} ball{'s' if objects > 1 else ''}"


def picture_name(scenario: Scenario, objects: int) -> str:
    """Name the picture of a group's errors over time."""
    return f"{scenario}-{objects}.png"


PREAMBLE = """<!-- Made by `python -m training evaluate --all`; do not edit. -->
# Results

Errors of every committed model on the first {scenes} scenes of the test split, from the fixed test
start. The test split is not used in training. Errors are in pixels of 128 x 128 frames. T is the
horizon, so the error at T is the error of step T - 1; "worst step" is the step with the largest
mean error. "Constant position" is the true position at t = 0, "linear extrapolation" a line through
ten true positions (t = -3..6). The covariances are those of the service: the network's
own covariances times a scale per step, which was fitted on validation scenes, or the covariance of
the residuals on validation scenes. The paper's networks were each trained on about 17 million
sequences, supervised by positions and angular velocities alone. The committed models were also
supervised by ground maps, heights and 3-D velocities, so "paper px" is not a like-for-like
comparison; [what we reproduced](reproduced.md) has one. Balls have a radius of 0.225 m."""


def _table(cells: Sequence[Measurement]) -> str:
    lines: list[Sequence[str]] = []
    for cell in cells:
        seen = "-" if cell.training_sequences is None else f"{cell.training_sequences:,}"
        lines.append((
            cell.method, cell.at.removeprefix("T="),
            f"{cell.position_error_px:.2f} ± {cell.standard_error_px:.2f}",
            _cell(cell.paper_px, 1), _cell(cell.angular_velocity_rmse), _cell(cell.nll_nats),
            _cell(cell.coverage_50), _cell(cell.coverage_95), seen,
        ))  # fmt: skip
    head = (
        "method", "T", "error px", "paper px", "ang. vel. RMSE rad/s", "neg. log likelihood",
        "in 50 %", "in 95 %", "trained on",
    )  # fmt: skip
    return table(head, lines)


def _row(manifest: Manifest, scenario: Scenario, horizon: int) -> MetricRow | None:
    wanted = ("test", scenario, horizon)
    rows = (row for row in manifest.metrics if (row.split, row.scenario, row.horizon) == wanted)
    return next(rows, None)


def _cell(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
