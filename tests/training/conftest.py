"""A tiny experiment with everything a real one has: one scenario, one shard, a few batches."""

from dataclasses import replace
from pathlib import Path

import pytest

from training.data.shards import Source
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Milestone, Recipe

HEMISPHERE = Source("hemisphere")
SCENES = 12
"""Of every split, in every test that uses the fixture ``runs``: a shard that one test has made is
read by all others."""
TRUE_STATE_WINDOWS = 8
"""Windows from true states beside every batch."""


@pytest.fixture(scope="session")
def runs(tmp_path_factory, worker_id):
    """Folder of runs, whose simulated scenes all processes of a test session share."""
    folder = shared_folder(tmp_path_factory, worker_id) / "runs"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROLLCAST_RUNS", str(folder))
        yield folder


def shared_folder(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """Return the folder of the session, above those of pytest-xdist's processes."""
    folder = tmp_path_factory.getbasetemp()
    return folder if worker_id == "master" else folder.parent


@pytest.fixture(scope="session")
def recipe(runs) -> Recipe:
    return tiny(one_ball())


def tiny(recipe: Recipe) -> Recipe:
    explicit = recipe.explicit
    if explicit is not None:
        explicit = replace(
            explicit, true_state_windows=min(explicit.true_state_windows, TRUE_STATE_WINDOWS)
        )
    return replace(
        recipe,
        data=(DataShare(HEMISPHERE, SCENES, share=1, latest_start=100),),
        scenarios=("hemisphere",),
        sequences=32,
        replay_windows=min(recipe.replay_windows, 40),
        batch_size=4,
        curriculum=(Milestone(0, 2), Milestone(1, 4)),
        validation_scenes=SCENES,
        explicit=explicit,
    )
