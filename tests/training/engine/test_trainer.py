from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.training.conftest import tiny
from training.common.distributed import Share
from training.common.run_folder import BEST
from training.data.feature_cache import replayed
from training.engine.loop import TrainerConfig, warmed_average
from training.engine.trainer import FEATURE_CACHE, Trainer, shared_factor
from training.engine.warm_start import Initial, load_fitting
from training.networks.compact import compact_family
from training.networks.task import Task
from training.recipes.compact import one_ball
from training.recipes.field import (
    field_one_ball,
    field_one_ball_interpolation,
    field_one_ball_rolling,
    field_one_ball_seeing,
    field_several_balls,
)
from training.recipes.perception_init import perception_init_one_ball
from training.recipes.recipe import Milestone, horizon_at, longest_rollout
from training.reporting.plots import draw_training

PACE = TrainerConfig(validate_every=4, checkpoint_seconds=0, workers=0)


@pytest.fixture(
    params=[one_ball, field_one_ball, perception_init_one_ball],
    ids=["shared state", "explicit state", "perception-initialised state"],
)
def any_recipe(request, runs):
    return tiny(request.param())


class MachineLostError(Exception):
    pass


class TrainerThatDies(Trainer):
    """Stops in the middle of a batch, as a lost machine does."""

    def _step(self, batch, progress):
        if self.batches == 5:
            raise MachineLostError
        return super()._step(batch, progress)


def test_a_stopped_training_ends_with_the_same_weights(any_recipe, tmp_path):
    whole = Trainer(any_recipe, tmp_path / "whole", PACE)
    whole.run()
    with pytest.raises(MachineLostError):
        TrainerThatDies(any_recipe, tmp_path / "stopped", PACE).run()
    resumed = Trainer(any_recipe, tmp_path / "stopped", PACE)
    resumed.run()

    assert resumed.sequences == whole.sequences == any_recipe.sequences
    for one, other in (
        (whole.family, resumed.family),
        (whole.averaged(), resumed.averaged()),
    ):
        expected = one.state_dict()
        for name, value in other.state_dict().items():
            torch.testing.assert_close(value, expected[name], rtol=0, atol=0)


def test_training_lowers_the_error_and_keeps_the_best(any_recipe, tmp_path):
    trainer = Trainer(any_recipe, tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.family.state_dict().items()}
    error = trainer.run()
    best = torch.load(tmp_path / BEST, weights_only=True)
    assert best["validation_error_px"] == error
    draw_training(tmp_path, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 10_000
    assert best["sequences"] <= any_recipe.sequences
    assert best["horizon"] == longest_rollout(any_recipe, best["sequences"] / any_recipe.sequences)
    changed = [n for n, v in trainer.family.state_dict().items() if not torch.equal(v, before[n])]
    taught = any_recipe.preset != "perception_init"
    assert set(changed) == {name for name in before if taught or ".perception." not in name}


def test_only_the_eye_learns_to_see(runs, tmp_path):
    trainer = Trainer(tiny(field_one_ball_seeing()), tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.family.state_dict().items()}
    trainer.run()
    changed = {n for n, v in trainer.family.state_dict().items() if not torch.equal(v, before[n])}
    assert changed == {name for name in before if ".perception." in name}


def test_motion_learns_at_a_rate_of_its_own(runs, tmp_path):
    recipe = tiny(field_one_ball())
    assert recipe.explicit is not None
    recipe = replace(recipe, explicit=replace(recipe.explicit, motion_rate=0.0))
    trainer = Trainer(recipe, tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.family.state_dict().items()}
    trainer.run()
    kept = {n for n, v in trainer.family.state_dict().items() if torch.equal(v, before[n])}
    assert kept == {name for name in before if ".rolling." in name}


def test_a_taught_eye_can_be_left_as_it_is(runs, tmp_path):
    trainer = Trainer(tiny(field_one_ball_rolling()), tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.family.state_dict().items()}
    trainer.run()
    kept = {n for n, v in trainer.family.state_dict().items() if torch.equal(v, before[n])}
    assert kept == {name for name in before if ".perception." in name}


@pytest.fixture
def bending(runs):
    return replace(tiny(field_one_ball_interpolation()), task=Task(final_step=3))


def test_windows_are_read_once_and_replayed(bending, tmp_path):
    trainer = Trainer(bending, tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.family.state_dict().items()}
    trainer.run()
    changed = {n for n, v in trainer.family.state_dict().items() if not torch.equal(v, before[n])}
    assert changed == {name for name in before if ".endpoint_correction." in name}
    outputs = torch.load(tmp_path / FEATURE_CACHE, weights_only=True)
    assert len(outputs["p"]) == len(outputs["s"]) == len(outputs["positions"]) == 64
    batch = next(replayed(tmp_path / FEATURE_CACHE, 6, 1, 3, Share()))
    drawn = batch["initial_state"].state.p
    where = [int((outputs["p"] == p).all(dim=(1, 2)).nonzero()) for p in drawn]
    assert torch.equal(batch["positions"], outputs["positions"][where])
    shared = next(replayed(tmp_path / FEATURE_CACHE, 6, 1, 3, Share(1, 3)))
    assert torch.equal(shared["positions"], batch["positions"][1::3])


def test_the_average_follows_closely_at_first_and_slowly_later():
    averaged = torch.optim.swa_utils.AveragedModel(
        torch.nn.Linear(1, 1, bias=False), multi_avg_fn=warmed_average(0.99)
    )
    moving = torch.nn.Linear(1, 1, bias=False)
    values = []
    for step in range(3000):
        moving.weight.data.fill_(float(step))
        averaged.update_parameters(moving)
        values.append(averaged.module.weight.item())
    lags = np.arange(3000) - values
    assert lags[10] < 5
    assert lags[-1] == pytest.approx(99, rel=0.01)


def test_horizon_grows_step_by_step_between_milestones():
    curriculum = (Milestone(0.2, 2), Milestone(0.6, 10))
    horizons = [horizon_at(curriculum, progress) for progress in np.linspace(0, 1, 101)]
    assert horizons[:20] == [2] * 20
    assert horizons[60:] == [10] * 41
    assert set(np.diff(horizons)) == {0, 1}


def test_weights_kept_early_claim_no_more_than_they_were_trained_on():
    recipe = field_several_balls(2)
    # Rollouts from true states are longer than those from frames, until both have the horizon.
    assert longest_rollout(recipe, 0.2) == 8
    assert longest_rollout(recipe, 0.5) == 15
    assert longest_rollout(recipe, 1.0) == recipe.trained_horizon == 30


def test_what_is_shared_waits_for_the_heads():
    assert shared_factor(0.5, 0) == 1
    assert shared_factor(0.1, 0.2) == 0
    assert shared_factor(0.21, 0.2) == pytest.approx(0.5)
    assert shared_factor(0.9, 0.2) == 1


def test_foreign_parameters_are_refused():
    family = compact_family({"one": "posnet"}, Task())
    with pytest.raises(ValueError, match="share no name"):
        load_fitting(family.networks()["one"], {"somebody.else": torch.zeros(3)})


def test_networks_begin_with_their_own_heads_and_the_first_ones_encoder(recipe, tmp_path):
    torch.manual_seed(7)
    posnet, probnet = (recipe.build().networks()[name] for name in ("posnet", "probnet"))
    initial = [
        Initial("probnet", probnet.state_dict(), 96),
        Initial("posnet", posnet.state_dict(), 640),
    ]
    members = Trainer(recipe, tmp_path, PACE, initial).family.networks()
    for name, own in (("posnet", posnet), ("probnet", probnet)):
        torch.testing.assert_close(
            members[name].motion.state_dict(), own.motion.state_dict(), rtol=0, atol=0
        )
    for member in members.values():
        assert member.encoder is members["posnet"].encoder
    torch.testing.assert_close(
        members["posnet"].encoder.state_dict(), probnet.encoder.state_dict(), rtol=0, atol=0
    )
