"""Recipes that a newcomer and a reader of the paper begin with train, and one is served."""

from dataclasses import replace

import numpy as np
import pytest

from rollcast.manifest import Manifest
from rollcast.rollout import roll_out
from tests.training.conftest import HEMISPHERE
from training.common.run_folder import read_best
from training.data.shards import SHARD_SCENES
from training.data.windows import fixed_windows
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.evaluation.evaluate import evaluation_sets
from training.export.export import export_run
from training.export.onnx_graphs import Graphs
from training.recipes import RECIPES
from training.recipes.recipe import DataShare
from training.recipes.tiny import tiny

PACE = TrainerConfig(validate_every=1000, checkpoint_seconds=1e9, workers=0)
PUBLISHED = [f"paper-{variant}" for variant in ("posnet", "dispnet", "probnet", "interpnet")]


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_networks_as_published_train_for_ten_batches(name, runs, tmp_path, monkeypatch):
    """On a GPU they would run as published: here the batches are small and the scenes few."""
    monkeypatch.setattr(
        "training.engine.trainer.fixed_windows",
        lambda recordings, *rest: fixed_windows(recordings[:2], *rest),
    )
    recipe = replace(
        RECIPES[name](),
        data=(DataShare(HEMISPHERE, SHARD_SCENES, share=1, latest_start=100),),
        scenarios=("hemisphere",),
        sequences=10,
        batch_size=1,
        validation_scenes=SHARD_SCENES,
    )
    trainer = Trainer(recipe, tmp_path, PACE)
    before = {key: value.clone() for key, value in trainer.family.state_dict().items()}
    assert np.isfinite(trainer.run())
    assert trainer.batches == 10
    moved = [k for k, v in trainer.family.state_dict().items() if not (v == before[k]).all()]
    assert moved
    assert read_best(tmp_path)["horizon"] == recipe.trained_horizon


def test_tiny_goes_from_nothing_to_a_model_that_graphs_forecast_with(runs, tmp_path):
    whole = tiny()
    assert [part.source for part in whole.data] == [HEMISPHERE]
    data = tuple(replace(part, scenes=SHARD_SCENES) for part in whole.data)
    recipe = replace(whole, data=data, sequences=64)
    Trainer(recipe, tmp_path / "run", PACE).run()
    (manifest,) = export_run(recipe, tmp_path / "run", tmp_path / "models", 1, SHARD_SCENES, 1)
    folder = tmp_path / "models" / "tiny" / "1"
    assert Manifest.read(folder / "manifest.json") == manifest
    assert manifest.simulated == ("hemisphere",)
    assert manifest.covariance.source == "empirical"
    (known,) = evaluation_sets(("hemisphere",), 1, None, "test", SHARD_SCENES, 1)
    frames = np.stack([window.frames for window in known.windows[:2]])
    positions = roll_out(Graphs(folder), frames, 5)["positions"]
    assert positions.shape == (2, 1, 5, 2)
    assert np.isfinite(positions).all()
