"""Two balls with a final frame, from a network of one ball without: the whole way to an export."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from rollcast.manifest import MANIFEST_FILE, Manifest
from tests.training.conftest import SCENES, tiny
from training.data.shards import Source
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.engine.warm_start import Initial
from training.export.export import export_run
from training.export.load import load_exported, read_initial
from training.networks.compact import compact_family
from training.networks.task import Task
from training.recipes.compact import several_balls_interpolation
from training.recipes.field import field_several_balls, field_several_balls_interpolation
from training.recipes.recipe import DataShare, Recipe

MODELS = Path(__file__).parents[3] / "models"
FINAL_STEP = 3
PACE = TrainerConfig(validate_every=2, checkpoint_seconds=1e9, workers=0)


@pytest.fixture(scope="module")
def two_balls(runs) -> Recipe:
    base = several_balls_interpolation(2)
    # The encoder's graph holds every step until the final one, and takes as long to export.
    base = replace(base, task=replace(base.task, final_step=FINAL_STEP))
    data = (DataShare(Source("ellipsoid", 2), SCENES, share=1, latest_start=100),)
    return replace(tiny(base), data=data, scenarios=base.scenarios, sequences=8)


@pytest.fixture(scope="module")
def posnet() -> Initial:
    """A network of one ball without a final frame."""
    torch.manual_seed(6)
    (network,) = compact_family({"posnet": "posnet"}, Task()).networks().values()
    return Initial("posnet", network.state_dict(), 100)


@pytest.fixture(scope="module")
def exported(two_balls, posnet, tmp_path_factory) -> Path:
    """Folder of the models that a few batches gave."""
    folder = tmp_path_factory.mktemp("two-balls")
    Trainer(two_balls, folder, PACE, [posnet]).run()
    export_run(two_balls, folder, folder, 1, SCENES, workers=1)
    return folder / "interpnet-2" / "1"


def test_the_manifest_tells_of_two_balls_and_the_final_frame(exported):
    manifest = Manifest.read(exported / MANIFEST_FILE)
    assert (manifest.objects, manifest.frames, manifest.final_step) == (2, 5, FINAL_STEP)
    assert {row.scenario for row in manifest.metrics} == {"ellipsoid"}
    assert max(row.horizon for row in manifest.metrics) == 30


def test_the_export_is_read_back(exported, two_balls):
    _, predictor = load_exported(exported)
    frames = torch.zeros(1, 5, 128, 128, 3, dtype=torch.uint8)
    with torch.inference_mode():
        forecast = predictor(frames, 3)
    assert forecast.positions.shape == (1, 2, 3, 2)
    assert forecast.final_positions is not None
    assert forecast.final_positions.shape == (1, 2, 2)


def test_a_wider_network_begins_as_the_narrower_one(two_balls, posnet, tmp_path):
    """Each ball gets the perception of one ball; the new inputs have no effect at first."""
    trainer = Trainer(two_balls, tmp_path, PACE, [posnet])
    (member,) = trainer.family.networks().values()
    own = member.state_dict()
    stem = "encoder.layers.0.weight"
    torch.testing.assert_close(own[stem][:, :12], posnet.parameters[stem])
    assert not own[stem][:, 12:].any()
    last = "encoder.layers.10.weight"
    torch.testing.assert_close(own[last], posnet.parameters[last].repeat(2, 1, 1, 1))
    first = "transition.first.weight"
    torch.testing.assert_close(own[first][:, :128], posnet.parameters[first])
    assert not own[first][:, 128:].any()


@pytest.mark.parametrize("make", [field_several_balls, field_several_balls_interpolation])
def test_two_balls_with_an_explicit_state_go_all_the_way(make, runs, tmp_path):
    base = make(2)
    if base.task.final_step is not None:
        base = replace(base, task=replace(base.task, final_step=FINAL_STEP))
    data = (DataShare(Source("ellipsoid", 2), SCENES, share=1, latest_start=100),)
    recipe = replace(tiny(base), data=data, scenarios=base.scenarios, sequences=8)
    Trainer(recipe, tmp_path, PACE, [read_initial(MODELS / "fieldnet-2" / "1")]).run()
    export_run(recipe, tmp_path, tmp_path, 1, SCENES, workers=1)
    manifest, network = load_exported(tmp_path / base.members[0].name / "1")
    assert (manifest.objects, manifest.final_step) == (2, base.task.final_step)
    assert manifest.covariance.source == "predicted"
    with torch.inference_mode():
        frames = torch.zeros(1, base.task.frames, 128, 128, 3, dtype=torch.uint8)
        forecast = network(frames, 3)
    assert forecast.positions.shape == (1, 2, 3, 2)
    assert forecast.covariances.shape == (1, 2, 3, 2, 2)
