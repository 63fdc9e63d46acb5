"""True states: the same sequences as the frames' windows, turned and mirrored alike."""

import numpy as np
import pytest
import torch

from rollcast.simulation.recording import TEST_START
from tests.training.conftest import SCENES
from training.baselines.states import VELOCITY_UNIT, StateSet, turned
from training.data.shards import Source, load_recordings, simulate_split
from training.data.windows import Symmetry, Window, WindowMaker
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT

HORIZON = 20


@pytest.fixture(scope="module")
def recordings(runs):
    return load_recordings(simulate_split(Source("ellipsoid"), "validation", SCENES, workers=2))[:6]


@pytest.fixture(scope="module")
def states(recordings):
    return StateSet(recordings).fixed(HORIZON)


def window(recordings, index: int) -> Window:
    start = TEST_START["ellipsoid"]
    return WindowMaker(recordings, None).window(index, start, HORIZON, seen=False)


def test_they_are_those_of_the_windows(recordings, states):
    for index in range(len(recordings)):
        truth = window(recordings, index)
        positions = 64 * (1 + states.positions[index, :, 3:].numpy())
        np.testing.assert_allclose(positions, truth.positions, atol=1e-4)
        spins = ANGULAR_VELOCITY_UNIT * states.spins[index, :, 3:].numpy()
        np.testing.assert_allclose(spins, truth.angular_velocities, atol=1e-4)


def test_velocities_lead_from_one_position_to_the_next(states):
    moved = states.positions[:, :, :-1] + states.velocities[:, :, 1:]
    torch.testing.assert_close(moved, states.positions[:, :, 1:], atol=1e-6, rtol=0)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarter_turns", range(4))
def test_they_turn_as_frames_do(recordings, states, quarter_turns, mirror):
    rows = len(recordings)
    moved = turned(states, torch.full((rows,), quarter_turns), torch.full((rows,), mirror))
    for index in range(rows):
        truth = Symmetry(quarter_turns, mirror).apply(window(recordings, index))
        positions = 64 * (1 + moved.positions[index, :, 3:].numpy())
        np.testing.assert_allclose(positions, truth.positions, atol=1e-3)
        spins = ANGULAR_VELOCITY_UNIT * moved.spins[index, :, 3:].numpy()
        np.testing.assert_allclose(spins, truth.angular_velocities, atol=1e-3)
    torch.testing.assert_close(
        moved.positions[:, :, 1:] - moved.positions[:, :, :-1],
        moved.velocities[:, :, 1:],
        atol=1e-5,
        rtol=0,
    )


def test_the_bowl_turns_with_them(recordings, states):
    """The bowl's long axis lies along y of its own, so it is at right angles to the ratio's."""
    scene = recordings[0].scene
    axis = np.array([np.cos(scene.rotation_rad), -np.sin(scene.rotation_rad)])
    for turns in range(4):
        for mirror in (False, True):
            moved = turned(states, torch.full((6,), turns), torch.full((6,), mirror))
            image = axis
            for _ in range(turns):
                image = np.array([image[1], -image[0]])
            image = image * np.array([-1 if mirror else 1, 1])
            ratio, cos, sin = moved.bowl[0].tolist()
            assert ratio == pytest.approx(scene.axis_ratio)
            twice = (image[0] ** 2 - image[1] ** 2, 2 * image[0] * image[1])
            assert (cos, sin) == pytest.approx(twice, abs=1e-5)


def test_a_batch_depends_on_its_number_alone(recordings):
    scenes = StateSet(recordings)
    long = scenes.drawn(5, 100, 4, seed=3, first_batch=0)
    for _ in range(2):
        next(long)
    late = next(scenes.drawn(5, 100, 4, seed=3, first_batch=2))
    for one, other in zip(next(long), late, strict=True):
        assert torch.equal(one, other)
    assert late.per_ball(angular_velocity=True).shape == (4, 1, 5, 10)
    assert VELOCITY_UNIT > 0
