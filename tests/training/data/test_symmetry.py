"""The eight symmetries that training draws, against scenes that are turned and mirrored."""

import math

import numpy as np
import pytest

from rollcast.camera import camera_for
from rollcast.scene import Scene
from rollcast.simulation import Simulator
from rollcast.simulation.rendering import Renderer
from tests.rollcast.simulation.lab import mirrored, turned
from training.data.shards import Recording
from training.data.windows import Symmetry, Window, WindowMaker

HORIZON = 12
START = 5


def window_of(simulator: Simulator, scene: Scene) -> Window:
    trajectory = simulator.simulate(scene, START + HORIZON + 4)
    assert trajectory is not None
    return WindowMaker([Recording(scene, trajectory)], None).window(0, START, HORIZON)


@pytest.fixture(scope="module")
def simulator():
    one = Simulator()
    yield one
    one.close()


@pytest.fixture(scope="module", params=[("hemisphere", 1), ("ellipsoid", 2), ("heightfield", 1)])
def scene(request, simulator) -> Scene:
    scenario, objects = request.param
    return simulator.sequence(scenario, objects, 2, 4).scene


def assert_alike(one: Window, other: Window) -> None:
    assert np.abs(one.frames.astype(int) - other.frames).max() <= 2
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-2)
    np.testing.assert_allclose(one.angular_velocities, other.angular_velocities, atol=1e-2)


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_a_quarter_turn_of_a_window_is_the_window_of_the_turned_scene(
    simulator, scene, quarter_turns
):
    expected = scene
    for _ in range(quarter_turns):
        expected = turned(expected)
    made = Symmetry(quarter_turns, mirror=False).apply(window_of(simulator, scene))
    assert_alike(made, window_of(simulator, expected))


@pytest.mark.parametrize("quarter_turns", [0, 1])
def test_a_mirrored_window_is_the_window_of_the_mirrored_scene(simulator, quarter_turns):
    """Angular velocity is a pseudo-vector.

    A mirror swaps the checkerboard's colours and the hand of the ball's texture; a hemisphere that
    stands one field further and a white ball undo that.
    """
    scene = simulator.sequence("hemisphere", 1, 3, 4, parameters={"textured": False}).scene
    expected = scene
    for _ in range(quarter_turns):
        expected = turned(expected)
    expected = mirrored(expected)
    rotation = math.remainder(expected.rotation_rad - math.pi / 10, 2 * math.pi)
    expected = expected.model_copy(update={"rotation_rad": rotation})
    made = Symmetry(quarter_turns, mirror=True).apply(window_of(simulator, scene))
    assert_alike(made, window_of(simulator, expected))


def test_the_eight_symmetries_differ_and_undo_themselves(simulator, scene):
    window = window_of(simulator, scene)
    views = [Symmetry(turns, mirror).apply(window) for turns in range(4) for mirror in (0, 1)]
    for index, one in enumerate(views):
        for other in views[:index]:
            assert np.abs(one.positions - other.positions).max() > 1
            assert not np.array_equal(one.frames, other.frames)
    for turns in range(4):
        back = Symmetry(4 - turns, False).apply(Symmetry(turns, False).apply(window))
        twice = Symmetry(turns, True).apply(Symmetry(turns, True).apply(window))
        again = back if turns % 2 else twice
        np.testing.assert_array_equal(again.frames, window.frames)
        np.testing.assert_allclose(again.positions, window.positions, atol=1e-9)
        np.testing.assert_allclose(again.angular_velocities, window.angular_velocities)


def test_a_window_shows_the_frames_and_the_truth_of_the_design(simulator, scene):
    """Step t = 0 is the last of the four seen frames; positions are pixels of 128 x 128 frames."""
    trajectory = simulator.simulate(scene, START + HORIZON + 4)
    assert trajectory is not None
    window = WindowMaker([Recording(scene, trajectory)], None).window(0, START, HORIZON)
    camera = camera_for(scene.scenario, 128)
    seen = trajectory.window(START, 4)
    np.testing.assert_array_equal(window.frames, Renderer(scene, camera).render(seen))
    assert window.positions.shape == (scene.objects, HORIZON, 2)
    np.testing.assert_array_equal(window.positions[:, 0], camera.project(seen.positions_m[3]))
    np.testing.assert_array_equal(window.angular_velocities[:, 0], seen.angular_velocities_rad_s[3])
