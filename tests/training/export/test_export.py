"""Export of an untrained network: what is proved does not depend on how good it is."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from rollcast.manifest import GAUSSIAN_ELLIPSE50_RADIUS, MANIFEST_FILE, PERCEPTION_FILE, Manifest
from tests.training.conftest import tiny
from training.engine.warm_start import load_fitting
from training.evaluation.evaluate import evaluation_sets
from training.export.export import export, fit_covariance, measure_parity, with_covariance
from training.export.load import load_exported, read_initial, read_parameters
from training.export.spec import Trained
from training.networks.perception import PerceptionNetwork
from training.objectives.metrics import Forecasts
from training.recipes.compact import one_ball, one_ball_interpolation
from training.recipes.field import field_one_ball

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module", params=["posnet", "probnet", "interpnet", "fieldnet"])
def exported(request, runs, tmp_path_factory):
    name = request.param
    recipes = {"interpnet": one_ball_interpolation, "fieldnet": field_one_ball}
    recipe = tiny(recipes.get(name, one_ball)())
    torch.manual_seed(5)
    predictor = recipe.build().networks()[name]
    with torch.no_grad():
        # The exporter folds parameters away that are still zero.
        for parameter in predictor.parameters():
            parameter.add_(0.003 * torch.randn(parameter.shape))
    sets = evaluation_sets(
        recipe.scenarios, 1, recipe.task.final_step, "validation", recipe.validation_scenes, 1
    )
    folder = tmp_path_factory.mktemp("models") / name / "1"
    export(Trained(recipe, name, predictor, 0, 2), folder, 1, sets, sets)
    return recipe, name, predictor, folder, sets


def test_manifest_reads_back_and_names_every_file(exported):
    _, name, _, folder, _ = exported
    manifest = Manifest.read(folder / MANIFEST_FILE)
    assert manifest.name == name
    assert all((folder / file).exists() for file in manifest.files)
    assert all(
        manifest.parity.max_abs_error[output] <= tolerance
        for output, tolerance in manifest.parity.tolerance.items()
    )
    predicted = name in ("probnet", "fieldnet")
    assert manifest.covariance.source == ("predicted" if predicted else "empirical")


def test_a_network_that_differs_from_its_export_is_found_out(exported):
    recipe, name, predictor, folder, sets = exported
    other = recipe.build().networks()[name]
    other.load_state_dict(predictor.state_dict())
    with torch.no_grad():
        for parameter in other.parameters():
            parameter.add_(0.05)
    with pytest.raises(ValueError, match="differ by"):
        measure_parity(other.eval(), folder, sets[0].windows[:2], horizons=(4,))


def test_parameters_come_back_from_the_graphs(exported):
    recipe, name, predictor, folder, _ = exported
    stored = read_parameters(folder)
    for parameter, value in predictor.state_dict().items():
        torch.testing.assert_close(stored[parameter], value, rtol=0, atol=0)
    fresh = recipe.build().networks()[name]
    assert set(load_fitting(fresh, stored)) == set(predictor.state_dict())
    assert read_initial(folder).sequences == 0
    _, rebuilt = load_exported(folder)
    torch.testing.assert_close(rebuilt.state_dict(), predictor.state_dict(), rtol=0, atol=0)


def test_perception_is_stored_in_bytes(exported):
    _, _, predictor, folder, _ = exported
    if not isinstance(predictor, PerceptionNetwork):
        assert not (folder / PERCEPTION_FILE).exists()
        return
    stored = {one.name: one for one in onnx.load(folder / PERCEPTION_FILE).graph.initializer}
    large = {name for name, value in predictor.named_parameters() if value.numel() >= 4096}
    in_bytes = {name for name, one in stored.items() if one.data_type == onnx.TensorProto.INT8}
    perception = {name for name in large & stored.keys() if name.startswith("perception.")}
    assert perception
    assert perception <= in_bytes


def test_graphs_tell_nothing_of_the_machine(exported):
    _, _, _, folder, _ = exported
    for file in folder.glob("*.onnx"):
        assert str(ROOT).encode() not in file.read_bytes()


def test_ellipses_hold_their_shares_whatever_a_few_forecasts_do():
    generator = np.random.default_rng(4)
    truth = 2 * generator.standard_normal((4000, 1, 3, 2))
    truth[:40] *= 100
    nowhere = np.zeros_like(truth)
    unit = np.tile(np.eye(2), (*truth.shape[:3], 1, 1))
    made = Forecasts(nowhere, unit, None, truth, np.zeros((4000, 1, 3, 3)))
    fitted = fit_covariance({"ellipsoid": made})
    assert fitted.variance_scale == pytest.approx([4, 4, 4], rel=0.15)
    served = with_covariance({"ellipsoid": made}, fitted)["ellipsoid"].calibration((0.5, 0.95))
    assert served is not None
    assert (abs(served[0.5] - 0.5) < 0.03).all()
    assert (abs(served[0.95] - 0.95) < 0.02).all()


@pytest.mark.parametrize("predicted", [True, False])
def test_where_tails_are_heavy_half_of_the_truths_have_a_radius_of_their_own(predicted):
    generator = np.random.default_rng(5)
    tails = np.sqrt(generator.chisquare(3, (8000, 1, 2, 1)) / 3)
    truth = 2 * generator.standard_normal((8000, 1, 2, 2)) / tails
    known, unseen = (
        Forecasts(
            np.zeros_like(part),
            np.tile(np.eye(2), (*part.shape[:3], 1, 1)) if predicted else None,
            None,
            part,
            np.zeros((4000, 1, 2, 3)),
        )
        for part in (truth[:4000], truth[4000:])
    )
    fitted = fit_covariance({"ellipsoid": known})
    assert fitted.ellipse50_radius is not None
    assert max(fitted.ellipse50_radius) < 0.9 * GAUSSIAN_ELLIPSE50_RADIUS
    served = with_covariance({"ellipsoid": unseen}, fitted)["ellipsoid"].calibration((0.5, 0.95))
    assert served is not None
    assert (abs(served[0.5] - 0.5) < 0.03).all()
    if predicted:
        assert (abs(served[0.95] - 0.95) < 0.02).all()


def test_any_batch_size_runs(exported):
    _, _, predictor, folder, sets = exported
    for size in (1, 2, 5):
        measure_parity(predictor, folder, sets[0].windows[:size], horizons=(2,))
