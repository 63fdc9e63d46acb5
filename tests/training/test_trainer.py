import numpy as np
import pytest
import torch

from training.models.posnet import compact_posnet
from training.recipes import Milestone
from training.trainer import BEST, Pace, Trainer, horizon_at, learning_rate_factor, load_fitting

PACE = Pace(validate_every=16, checkpoint_seconds=0, workers=0)


class MachineLostError(Exception):
    pass


class TrainerThatDies(Trainer):
    """Stops in the middle of a batch, as a lost machine does."""

    def _step(self, batch, spent):
        if self.batches == 5:
            raise MachineLostError
        return super()._step(batch, spent)


def test_a_stopped_training_ends_with_the_same_weights(tiny_posnet, tmp_path):
    whole = Trainer(tiny_posnet, tmp_path / "whole", PACE)
    whole.run()
    with pytest.raises(MachineLostError):
        TrainerThatDies(tiny_posnet, tmp_path / "stopped", PACE).run()
    resumed = Trainer(tiny_posnet, tmp_path / "stopped", PACE)
    resumed.run()

    assert resumed.sequences == whole.sequences == tiny_posnet.sequences
    for one, other in (
        (whole.predictor, resumed.predictor),
        (whole.averaged(), resumed.averaged()),
    ):
        expected = one.state_dict()
        for name, value in other.state_dict().items():
            torch.testing.assert_close(value, expected[name], rtol=0, atol=0)


def test_training_lowers_the_error_and_keeps_the_best(tiny_probnet, tmp_path):
    trainer = Trainer(tiny_probnet, tmp_path, PACE)
    before = {name: value.clone() for name, value in trainer.predictor.state_dict().items()}
    error = trainer.run()
    best = torch.load(tmp_path / BEST, weights_only=True)
    assert best["validation_error_px"] == error
    assert best["sequences"] <= tiny_probnet.sequences
    changed = [
        n for n, v in trainer.predictor.state_dict().items() if not torch.equal(v, before[n])
    ]
    assert set(changed) == set(before)


def test_horizon_grows_step_by_step_between_milestones():
    curriculum = (Milestone(0.2, 2), Milestone(0.6, 10))
    horizons = [horizon_at(curriculum, spent) for spent in np.linspace(0, 1, 101)]
    assert horizons[:20] == [2] * 20
    assert horizons[60:] == [10] * 41
    assert set(np.diff(horizons)) == {0, 1}


def test_learning_rate_rises_then_falls_to_zero():
    assert learning_rate_factor(0, 0.1) == 0
    assert learning_rate_factor(0.1, 0.1) == 1
    assert learning_rate_factor(1, 0.1) == pytest.approx(0)


def test_foreign_parameters_are_refused():
    network = compact_posnet(4, 1, angular_velocity=True)
    with pytest.raises(ValueError, match="share no name"):
        load_fitting(network, {"somebody.else": torch.zeros(3)})
