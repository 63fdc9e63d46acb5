"""The world looks the same from every side: turned and mirrored scenes."""

import numpy as np
import pytest

from rollcast.camera import camera_for
from rollcast.scene import SCENARIOS
from rollcast.simulation.rendering import Renderer
from tests.rollcast.simulation.lab import mirrored, turned

FRAMES = 44


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("objects", [1, 3])
def test_a_turned_scene_takes_the_turned_course(simulator, scenario, objects):
    scene = simulator.sequence(scenario, objects, 3, 4).scene
    course = simulator.simulate(scene, FRAMES).window(0, FRAMES)
    other = simulator.simulate(turned(scene), FRAMES).window(0, FRAMES)
    for before, after in (
        (course.positions_m, other.positions_m),
        (course.angular_velocities_rad_s, other.angular_velocities_rad_s),
    ):
        expected = np.stack([-before[..., 1], before[..., 0], before[..., 2]], axis=-1)
        np.testing.assert_allclose(after, expected, atol=5e-4)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("objects", [1, 3])
def test_a_turned_scene_gives_the_turned_image(simulator, scenario, objects):
    scene = simulator.sequence(scenario, objects, 3, 4).scene
    camera = camera_for(scenario, 128)
    course = simulator.simulate(scene, 10).window(0, 10)
    other = simulator.simulate(turned(scene), 10).window(0, 10)
    images = Renderer(scene, camera).render(course)
    images_of_turned = Renderer(turned(scene), camera).render(other)
    expected = np.rot90(images, 1, axes=(1, 2)).astype(int)
    assert not np.array_equal(expected, images)
    assert np.abs(images_of_turned - expected).max() <= 2


@pytest.mark.parametrize("scenario", ["hemisphere", "ellipsoid"])
@pytest.mark.parametrize("objects", [1, 3])
def test_a_mirrored_bowl_takes_the_mirrored_course(simulator, scenario, objects):
    """Angular velocity is a pseudo-vector: across x = 0 it keeps its x and flips the others."""
    scene = simulator.sequence(scenario, objects, 1, 4).scene
    course = simulator.simulate(scene, FRAMES).window(0, FRAMES)
    other = simulator.simulate(mirrored(scene), FRAMES).window(0, FRAMES)
    np.testing.assert_allclose(other.positions_m, course.positions_m * [-1, 1, 1], atol=1e-5)
    np.testing.assert_allclose(
        other.angular_velocities_rad_s,
        course.angular_velocities_rad_s * [1, -1, -1],
        atol=1e-3,
    )
    alike = np.sum(other.orientations_xyzw * course.orientations_xyzw * [1, -1, -1, 1], axis=-1)
    np.testing.assert_allclose(np.abs(alike), 1, atol=1e-6)
