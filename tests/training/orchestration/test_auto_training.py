"""Which family trains next, and what it begins with."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from rollcast.manifest import MANIFEST_FILE, Manifest
from training.orchestration.auto_training import (
    OUTCOME,
    Line,
    Round,
    RoundResult,
    finish,
    initial_of,
    next_rounds,
    own_models,
)
from training.recipes.compact import one_ball, several_balls
from training.recipes.perception_init import perception_init_one_ball

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture
def known() -> list[Line]:
    return [
        Line(replace(perception_init_one_ball(), name="one-ball")),
        Line(several_balls(2), parents=("posnet", "probnet")),
    ]


def done(folder, name: str, number: int, before: float | None, after: float) -> None:
    at = folder / name / str(number)
    at.mkdir(parents=True)
    (at / OUTCOME).write_text(json.dumps(asdict(RoundResult(before, after))))


def choices(known, folder) -> list[Round]:
    return next_rounds(known, folder, MODELS, 640)


def choose(known, folder) -> Round | None:
    return next(iter(choices(known, folder)), None)


def test_an_interrupted_round_goes_on_first(known, tmp_path):
    done(tmp_path, "one-ball", 0, None, 9.0)
    (tmp_path / "2-balls" / "0").mkdir(parents=True)
    chosen = choose(known, tmp_path)
    assert chosen is not None
    assert (chosen.recipe.name, chosen.number) == ("2-balls", 0)
    assert chosen.recipe.sequences == 640


def test_families_without_a_round_come_in_order(known, tmp_path):
    first = choose(known, tmp_path)
    assert first is not None
    assert first.recipe.name == "one-ball"
    done(tmp_path, "one-ball", 0, None, 9.0)
    second = choose(known, tmp_path)
    assert second is not None
    assert second.recipe.name == "2-balls"


def test_the_family_that_gained_most_goes_on_until_none_gains(known, tmp_path):
    done(tmp_path, "one-ball", 0, 10.0, 9.0)
    done(tmp_path, "2-balls", 0, 10.0, 8.0)
    chosen = choose(known, tmp_path)
    assert chosen is not None
    assert (chosen.recipe.name, chosen.number) == ("2-balls", 1)
    finish_in(tmp_path, chosen, RoundResult(8.0, 7.99))
    following = choose(known, tmp_path)
    assert following is not None
    assert (following.recipe.name, following.number) == ("one-ball", 1)
    finish_in(tmp_path, following, RoundResult(9.0, 9.1))
    assert choose(known, tmp_path) is None


def test_side_by_side_are_rounds_that_do_not_need_each_other(known, tmp_path):
    """The second line begins with what the first one makes."""
    assert [one.recipe.name for one in choices(known, tmp_path)] == ["one-ball"]
    independent = [known[0], replace(known[1], parents=())]
    assert [one.recipe.name for one in choices(independent, tmp_path)] == ["one-ball", "2-balls"]
    done(tmp_path, "one-ball", 0, 10.0, 9.0)
    done(tmp_path, "2-balls", 0, 10.0, 8.0)
    assert [one.recipe.name for one in choices(known, tmp_path)] == ["2-balls", "one-ball"]
    for name in ("one-ball", "2-balls"):
        (tmp_path / name / "1").mkdir()
    assert [one.number for one in choices(known, tmp_path)] == [1, 1]


def finish_in(folder, chosen: Round, outcome: RoundResult) -> None:
    at = folder / chosen.recipe.name / str(chosen.number)
    at.mkdir(parents=True)
    finish(replace(chosen, folder=at), outcome)


def test_models_of_another_preset_are_no_beginning(tmp_path):
    """The committed PosNet is none that sees with FieldNet's perception, unless it says so."""
    committed = Manifest.read(MODELS / "posnet" / "1" / MANIFEST_FILE)
    for base in (one_ball(), perception_init_one_ball()):
        found = {folder.parent.name for folder in own_models(base, MODELS)}
        assert ("posnet" in found) == (committed.preset == base.preset)


def test_a_family_begins_with_its_own_models_or_its_parents(known, tmp_path):
    first = choose(known[:1], tmp_path)
    assert first is not None
    assert {initial.name for initial in initial_of(first, MODELS)} >= {"posnet", "probnet"}
    other = choose(known[1:], tmp_path)
    assert other is not None
    assert [initial.name for initial in initial_of(other, MODELS)] == ["posnet", "probnet"]
    assert other.recipe.heads_alone > 0
