from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import IterableDataset

from training.common.run_folder import read_best
from training.data.ball_batch import collate
from training.data.ball_windows import planar_window
from training.engine.ball_trainer import BallTrainer, BallTraining
from training.engine.loop import TrainerConfig
from training.evaluation.any_ball import validation_errors
from training.networks.any_ball import AnyBallNet


class Windows(IterableDataset):
    """Batches of planar scenes."""

    def __init__(self, first: int) -> None:
        self._first = first

    def __iter__(self):
        while True:
            yield collate([planar_window(np.random.default_rng(k)) for k in range(3)])


@pytest.fixture(scope="module")
def unseen():
    return [planar_window(np.random.default_rng(100 + k)) for k in range(2)]


def trainer(folder: Path, batches: int, unseen) -> BallTrainer:
    torch.manual_seed(2)
    training = BallTraining(batches, 3)
    config = TrainerConfig(validate_every=100, workers=0)
    return BallTrainer(
        AnyBallNet(),
        training,
        folder,
        Windows,
        {"planar": 3},
        lambda net: validation_errors(net, unseen),
        config,
    )


def test_training_changes_perception_alone_and_goes_on_where_it_stopped(tmp_path, unseen):
    torch.manual_seed(2)
    before = {name: value.clone() for name, value in AnyBallNet().state_dict().items()}
    trainer(tmp_path, 2, unseen).run()
    resumed = trainer(tmp_path, 3, unseen)
    error = resumed.run()
    assert resumed.batches == 3
    assert [batches for batches, _ in resumed.validations] == [2, 3]
    assert error == min(error for _, error in resumed.validations)
    moved = {n for n, v in resumed.network.state_dict().items() if not torch.equal(v, before[n])}
    assert any(name.startswith("perception.detector.said") for name in moved)
    assert any(name.startswith("perception.refiner.registration") for name in moved)
    assert not any(name.startswith(("rolling", "first_covariance")) for name in moved)
    best = read_best(tmp_path)
    assert best["weights"].keys() == before.keys()
    assert (best["sequences"], best["scenes"]) in [(6, {"planar": 3}), (9, {"planar": 3})]


def test_the_loss_falls_on_what_is_seen_again_and_again(tmp_path, unseen):
    torch.manual_seed(3)
    training = trainer(tmp_path, 40, unseen)
    batch = next(iter(Windows(0)))
    first = training._step(batch, 0.1)
    for _ in range(14):
        last = training._step(batch, 0.1)
    assert last < 0.8 * first


def test_trajectories_teach_the_refiner_where_a_future_is_known(tmp_path, unseen):
    made = trainer(tmp_path, 10, unseen)
    made.training = replace(made.training, trajectory=1.0, horizon=6, refined_per_window=3.0)
    batch = next(iter(Windows(0)))
    assert made.losses(batch)["trajectories"] == 0  # planar scenes have no future
    first = batch.centres[:, 0, :4, :2]
    velocity = first[:, -1:] - first[:, -2:-1]
    future = first[:, -1:] + torch.arange(1, batch.centres.shape[2] - 3)[:, None] * velocity
    batch.centres[:, 0, :, :2] = torch.cat([first, future], dim=1)
    missed = made.losses(batch)["trajectories"]
    assert missed > 0
    missed.backward()
    gradients = {
        name: parameter.grad.abs().max()
        for name, parameter in made.network.named_parameters()
        if parameter.grad is not None
    }
    assert gradients["perception.refiner.correction.weight"] > 0
    assert gradients["perception.state.0.weight"] > 0
    assert not any(name.startswith("rolling") for name in gradients)
