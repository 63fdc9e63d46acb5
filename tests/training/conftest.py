"""A tiny experiment with everything a real one has: one scenario, one shard, a few batches."""

from dataclasses import replace

import pytest

from training.data.shards import SHARD_SCENES, Source
from training.recipes.compact import one_ball
from training.recipes.recipe import DataShare, Milestone, Recipe

HEMISPHERE = Source("hemisphere")


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """Folder of runs that keeps its simulated scenes for the whole session."""
    with pytest.MonkeyPatch.context() as environment:
        folder = tmp_path_factory.mktemp("runs")
        environment.setenv("ROLLCAST_RUNS", str(folder))
        yield folder


@pytest.fixture(scope="session")
def recipe(runs) -> Recipe:
    return tiny(one_ball())


def tiny(recipe: Recipe) -> Recipe:
    return replace(
        recipe,
        data=(DataShare(HEMISPHERE, SHARD_SCENES, share=1, latest_start=100),),
        scenarios=("hemisphere",),
        sequences=32,
        replay_windows=min(recipe.replay_windows, 40),
        batch_size=4,
        curriculum=(Milestone(0, 2), Milestone(1, 4)),
        validation_scenes=SHARD_SCENES,
    )
