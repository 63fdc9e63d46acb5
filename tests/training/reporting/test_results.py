"""Figures of a committed model on a few test scenes: kept, read back, drawn."""

from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from tests.training.conftest import SCENES
from training.evaluation.paper import angular_speed_rad_s, published
from training.reporting.markdown import page
from training.reporting.results import Results, disagreements
from training.studies.publish import publish

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture(scope="module")
def made(runs, tmp_path_factory):
    """Results of every committed model, and the folder that they were published in."""
    folder = tmp_path_factory.mktemp("docs")
    return publish(MODELS, folder, SCENES, workers=2), folder


def test_results_are_read_back_as_they_were_written(made):
    results, docs = made
    assert Results.read(docs / "results" / "results.json") == results
    assert (docs / "results.md").read_text() == page(results, SCENES)


def test_every_picture_of_the_page_is_there(made):
    _, docs = made
    names = [line.split("](")[1][:-1] for line in (docs / "results.md").read_text().splitlines()
             if line.startswith("![")]  # fmt: skip
    assert len(names) >= 3
    for name in names:
        with Image.open(docs / name) as picture:
            assert picture.width > 300


def test_the_committed_results_are_those_of_the_committed_models(made):
    results, _ = made
    stored = Results.read(MODELS.parent / "docs" / "results" / "results.json")
    assert disagreements(results, stored) == []


def test_the_models_beat_staying_put_and_agree_with_themselves(made):
    results, _ = made
    errors = {(c.scenario, c.method, c.at): c.position_error_px for c in results.cells}
    for cell in results.cells:
        if cell.variant == "posnet" and cell.at == "T=20":
            assert cell.position_error_px < errors[cell.scenario, "constant position", "T=20"]
    assert disagreements(results, results) == []


def test_a_figure_that_is_off_is_found(made):
    results, _ = made
    first = results.cells[0]
    wrong = replace(first, position_error_px=first.position_error_px * 3 + 1)
    assert len(disagreements(replace(results, cells=(wrong,)), results)) == 1
    unknown = replace(first, method="nobody@1")
    assert "not in the stored" in disagreements(replace(results, cells=(unknown,)), results)[0]


def test_the_papers_figures_are_those_of_its_tables():
    line = published("hemisphere", 1, "linear extrapolation", "T=40")
    assert line is not None
    assert line.position_error_px == 127.5
    probnet = published("ellipsoid", 2, "probnet", "T=30")
    assert probnet is not None
    assert (probnet.position_error_px, probnet.nll_nats) == (19.8, 14.0)
    assert published("ellipsoid", 1, "linear extrapolation", "T=20") is None
    assert angular_speed_rad_s("heightfield") == 2.8
