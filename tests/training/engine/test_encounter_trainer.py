from pathlib import Path

import numpy as np
import pytest
import torch

from tests.training.conftest import SCENES
from training.data.ball_windows import BallSource, BallWindowMaker
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, load_recordings, simulate_split
from training.engine.encounter_trainer import EncounterTraining, train_encounters
from training.export.load import any_ball_from
from training.networks.fieldnet import Ball
from training.networks.recurrent import State

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture(scope="module")
def source(runs) -> BallSource:
    shards = simulate_split(Source("ellipsoid", 2), "training", SCENES, 1)
    maker = BallWindowMaker(load_recordings(shards), load_scene_cache(shards, 1))
    return BallSource(maker, 1.0, 100)


def alone() -> State:
    """One ball on level ground."""
    numbers = torch.zeros(1, 1, 3)
    centre = torch.tensor([[[0.1, 0.2, 0.15]]])
    ball = Ball(centre, numbers + 0.03, numbers, numbers, torch.tensor([[[0.0, 0.8]]]))
    return State(torch.zeros(1, 3, 32, 32), ball.packed())


def test_meeting_others_is_learned_and_moving_alone_stays_as_it_was(source):
    network = any_ball_from(MODELS)
    before = network.roll_out(alone(), 5).positions
    weights = network.rolling.layers[0].weight.detach().clone()
    training = EncounterTraining(batches=12, batch_size=8, horizon=6)
    losses = list(train_encounters(network, [source], training))
    assert len(losses) == 12
    assert np.isfinite(losses).all()
    assert not torch.equal(network.rolling.layers[0].weight, weights)
    assert torch.equal(network.roll_out(alone(), 5).positions, before)
