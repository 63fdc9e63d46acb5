"""Recipes that a newcomer and a reader of the paper begin with train, and one is served."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rollcast.manifest import Manifest
from rollcast.rollout import roll_out
from tests.training.conftest import HEMISPHERE, SCENES
from training.engine.loop import TrainerConfig
from training.engine.speed import dry_run
from training.engine.trainer import Trainer
from training.evaluation.evaluate import evaluation_sets
from training.export.export import export_run
from training.export.onnx_graphs import Graphs
from training.recipes import RECIPES
from training.recipes.recipe import DataShare
from training.recipes.tiny import tiny

PACE = TrainerConfig(validate_every=1000, checkpoint_seconds=1e9, workers=0)
PUBLISHED = [f"paper-{variant}" for variant in ("posnet", "dispnet", "probnet", "interpnet")]


VGG16_MACS = 15.3e9 * (128 / 224) ** 2
"""Multiply-adds of its convolutions on a frame, from the usual figure for 224 pixels."""


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_networks_as_published_train(name, runs, tmp_path):
    """On a GPU they would run as published: here the batches are small and the scenes few."""
    recipe = replace(
        RECIPES[name](),
        data=(DataShare(HEMISPHERE, SCENES, share=1, latest_start=100),),
        batch_size=1,
    )
    trainer = Trainer(recipe, tmp_path, PACE)
    before = {key: value.clone() for key, value in trainer.family.state_dict().items()}
    made = dry_run(trainer, 2, trainer.device)
    assert len(made.losses) == 2
    assert np.isfinite(made.losses).all()
    moved = {k for k, v in trainer.family.state_dict().items() if not torch.equal(v, before[k])}
    assert moved >= {key for key in before if "encoder" in key}
    # Forwards, and twice as much backwards; the transition and the read-outs come on top.
    assert made.flop > 3 * 2 * VGG16_MACS
    assert 0 < made.flop_s < 1.5 * made.peak_flop_s


def test_tiny_goes_from_nothing_to_a_model_that_graphs_forecast_with(runs, tmp_path):
    whole = tiny()
    assert [part.source for part in whole.data] == [HEMISPHERE]
    data = tuple(replace(part, scenes=SCENES) for part in whole.data)
    recipe = replace(whole, data=data, sequences=64, validation_scenes=SCENES)
    Trainer(recipe, tmp_path / "run", PACE).run()
    (manifest,) = export_run(recipe, tmp_path / "run", tmp_path / "models", 1, SCENES, 1)
    folder = tmp_path / "models" / "tiny" / "1"
    assert Manifest.read(folder / "manifest.json") == manifest
    assert manifest.simulated == ("hemisphere",)
    assert manifest.covariance.source == "empirical"
    (known,) = evaluation_sets(("hemisphere",), 1, None, "test", SCENES, 1)
    frames = np.stack([window.frames for window in known.windows[:2]])
    positions = roll_out(Graphs(folder), frames, 5)["positions"]
    assert positions.shape == (2, 1, 5, 2)
    assert np.isfinite(positions).all()
