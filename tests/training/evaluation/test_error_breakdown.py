"""What is replaced by the truth is no longer wrong, and nothing else changes."""

import numpy as np
import pytest
import torch

from tests.training.conftest import SCENES
from training.data.shards import Source
from training.evaluation.error_breakdown import SUBSTITUTES, breakdown_of, breakdown_table
from training.networks.fieldnet import FieldNet
from training.networks.task import Task


@pytest.fixture(scope="module")
def errors(runs):
    torch.manual_seed(6)
    network = FieldNet(Task()).eval()
    return breakdown_of(network, Source("hemisphere"), SCENES, workers=1)


def test_true_parts_take_their_error_away(errors):
    """An untaught network keeps its balls' velocities: two true steps are nearly exact."""
    assert set(errors) == set(SUBSTITUTES)
    assert errors["nothing"][0] > 1
    assert errors["the centre"][0] < 1e-3
    assert errors["the velocity"][0] == pytest.approx(errors["nothing"][0])
    assert errors["centre, velocity and spin"][1] < 1.5
    np.testing.assert_allclose(errors["everything"], errors["centre, velocity and spin"])


def test_the_table_names_every_part(errors):
    table = breakdown_table({"hemisphere": errors}, objects=1).splitlines()
    assert "hemisphere, T=20 | hemisphere, T=40" in table[0]
    assert [line.split(" | ")[0].removeprefix("| ") for line in table[2:]] == list(SUBSTITUTES)
    assert f"{errors['nothing'][19]:.2f}" in table[2]
