"""Studies: rows are kept as they are measured, tables and claims say what was measured."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from training.data.shards import SHARD_SCENES
from training.evaluation.paper import CELLS, published
from training.recipes.compact import ONE_BALL_DATA
from training.reporting.plots import _look, draw_errors, draw_group
from training.reporting.results import Curve, Measurement, Results
from training.studies import STUDIES
from training.studies.benchmark_case import BenchmarkCase
from training.studies.claims import CLAIMS, Claim, Comparison, verdicts
from training.studies.publish import publish_study
from training.studies.rows import StudyBudget, least_squares, npe, resting
from training.studies.study import Study
from training.studies.tables import page

ROOT = Path(__file__).parents[3]
SMALL = Study(
    "small",
    "A small study",
    "Few scenes.",
    (BenchmarkCase("hemisphere"),),
    lambda: (resting(), least_squares("line", 1), npe(angular_velocity=True)),
)


@pytest.fixture(scope="module")
def measured(runs, tmp_path_factory):
    """A small study that was run row by row, in its folder."""
    docs = tmp_path_factory.mktemp("docs")
    (docs / "results").mkdir()
    file = docs / "results" / "results.json"
    Results((), ()).write(file)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("training.studies.rows.VALIDATION_SCENES", SHARD_SCENES)
        patch.setattr(BenchmarkCase, "data", property(_few_scenes))
        efforts = [
            StudyBudget(2, 100),
            StudyBudget(2, 100),
            StudyBudget(2, 50),
            StudyBudget(2, 200),
        ]
        rows: list[list[str]] = [["line"], [], [], []]
        done = [
            list(SMALL.run(file, SHARD_SCENES, budget, methods))
            for budget, methods in zip(efforts, rows, strict=True)
        ]
    return docs, done


def _few_scenes(case: BenchmarkCase):
    whole = next(part for part in ONE_BALL_DATA if part.source == case.source)
    return replace(whole, scenes=SHARD_SCENES)


def test_a_row_is_measured_again_only_with_more_training(measured):
    _, done = measured
    assert [[line.split(":")[0] for line in lines] for lines in done] == [
        ["hemisphere-1, line"],
        ["hemisphere-1, stays put", "hemisphere-1, npe"],
        [],
        ["hemisphere-1, npe"],
    ]


def test_the_page_tells_what_a_row_was_trained_on(measured):
    docs, _ = measured
    text = page(SMALL, Results.read(docs / "results" / "results.json"))
    ends = {line.split(" | ")[0]: line.split(" | ")[-1] for line in text.splitlines()}
    assert ends["| npe"] == "200 |"
    assert ends["| line"] == "- |"


def test_the_page_has_every_row_and_its_pictures(measured):
    docs, _ = measured
    publish_study(SMALL, docs)
    text = (docs / "results" / "small.md").read_text()
    line = next(one for one in text.splitlines() if one.startswith("| line |"))
    paper = published("hemisphere", 1, "line", "T=40")
    assert paper is not None
    assert f"/ {paper.position_error_px}" in line
    assert "| npe | states |" in text
    for name in ("small-bars.png", "small-hemisphere-1.png"):
        assert (docs / "results" / name).stat().st_size > 5000


@pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
def test_every_row_of_a_table_has_a_line_of_its_own(study, tmp_path):
    rows = study.rows()
    curves = [
        Curve("hemisphere", 1, row.method, 20, ((1.0,) * 40, (2.0,) * 40, (3.0,) * 40))
        for row in rows
    ]
    draw_errors(curves, tmp_path / "curves.png")
    looks = [_look(index) for index in range(len(rows))]
    assert len(set(looks)) == len(rows)


def test_bars_stand_side_by_side_in_the_order_of_the_table():
    moments = ("T=10", "T=20", "T=30", "T=40")
    cells = [replace(_cell(method, 2.0), at=at, paper_px=1.0) for method in "ba" for at in moments]
    axes = Figure().subplots()
    draw_group(axes, cells, {"a": False, "absent": True, "b": True})
    assert [text.get_text() for text in axes.get_xticklabels()] == ["a", "b"]
    drawn = [bar for bar in axes.patches if isinstance(bar, Rectangle)]
    bars = sorted(drawn, key=lambda bar: bar.get_x())
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in bars]
    assert all(after[0] >= before[1] - 1e-9 for before, after in pairwise(ends))
    assert [bar.get_hatch() for bar in bars] == [None] * 4 + ["///"] * 4


def test_a_row_that_is_not_there_is_named(measured):
    docs, _ = measured
    with pytest.raises(ValueError, match=r"no row .'nobody'.; its rows: stays put, line, npe"):
        list(SMALL.run(docs / "results" / "results.json", SHARD_SCENES, StudyBudget(), ["nobody"]))


def _cell(method: str, error: float) -> Measurement:
    return Measurement("hemisphere", 1, method, method, "T=20", error, 0.1, 500)


def test_claims_hold_do_not_hold_or_are_open():
    def claim(least: int | None = None) -> Claim:
        pairs = (("a", "b"), ("a", "c"))
        return Claim(
            "long-term", "a is the best",
            tuple(Comparison("hemisphere", 1, one, other, "T=20") for one, other in pairs), least,
        )  # fmt: skip

    cells = [_cell("a", 1.0), _cell("b", 2.0)]
    outcomes = [
        verdicts([claim()], given)[0].outcome
        for given in (cells, [*cells, _cell("c", 3.0)], [*cells, _cell("c", 0.5)])
    ]
    assert outcomes == ["open", "holds", "does not hold"]
    assert verdicts([claim(least=1)], [*cells, _cell("c", 0.5)])[0].outcome == "holds"


def test_the_papers_own_figures_bear_its_claims_out():
    """Judged by the paper's cells no claim may fail: it would be misread."""
    cells = [
        Measurement(
            scenario,
            objects,
            method,
            method,
            at,
            found.position_error_px,
            0,
            1,
            condition=condition,
        )
        for (scenario, objects, method, at, condition), found in CELLS.items()
    ]
    found = verdicts(CLAIMS, cells)
    assert {one.outcome for one in found} == {"holds", "open"}
    # The paper prints the ellipsoid's polynomials in a wrong order, so they are left out.
    assert [one.claim.text for one in found if one.outcome == "open"] == [
        text for text in (claim.text for claim in CLAIMS) if "polynomials" in text
    ]


def test_the_committed_pages_are_those_of_the_committed_results():
    results = Results.read(ROOT / "docs" / "results" / "results.json")
    for study in STUDIES.values():
        file = ROOT / "docs" / "results" / f"{study.name}.md"
        assert file.read_text() == page(study, results)
