"""Our pictures of balls against PyBullet's own renderer."""

import math
from collections.abc import Iterator

import numpy as np
import pybullet
import pytest

from rollcast.camera import camera_for
from rollcast.scene import SCENARIOS, Scene
from tests.rollcast.simulation.pictures import centre_of, owners

SIZE = 128
DISTANCE_M = 1000.0
"""PyBullet's orthographic pictures are blank; from so far away perspective shifts 0.06 px."""


@pytest.fixture(scope="module")
def stage() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


SAMPLED_AT = np.array([-0.5, 0.5])
"""PyBullet looks through the lower left corner of a pixel, not through its centre."""


def seen_by_pybullet(client: int, scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Index of the ball that every pixel shows, -1 for none."""
    pybullet.resetSimulation(physicsClientId=client)
    shape = pybullet.createVisualShape(
        pybullet.GEOM_SPHERE, radius=scene.radius_m, physicsClientId=client
    )
    balls = [
        pybullet.createMultiBody(0, -1, shape, position, physicsClientId=client)
        for position in positions.tolist()
    ]
    half = camera_for(scene.scenario, SIZE).half_width_m
    view = pybullet.computeViewMatrix((0, 0, DISTANCE_M), (0, 0, 0), (0, 1, 0))
    fov = 2 * math.degrees(math.atan(half / DISTANCE_M))
    projection = pybullet.computeProjectionMatrixFOV(fov, 1, DISTANCE_M - 5, DISTANCE_M + 5)
    *_, segmentation = pybullet.getCameraImage(
        SIZE, SIZE, view, projection, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
    bodies = np.reshape(segmentation, (SIZE, SIZE))
    return np.select([bodies == ball for ball in balls], range(len(balls)), -1)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_balls_appear_where_pybullet_sees_them(stage, simulator, scenario):
    scene = simulator.sequence(scenario, 3, 1, 4).scene
    # Well apart and above the ground, for which PyBullet has no picture here.
    generator = np.random.default_rng(3)
    for _ in range(4):
        angles = generator.uniform(0, 2) + np.array([0, 2, 4]) * math.pi / 3
        heights = generator.uniform(0.8, 1.2, 3)
        positions = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), heights], axis=1)
        theirs, ours = seen_by_pybullet(stage, scene, positions), owners(scene, positions)
        for ball in range(3):
            expected = centre_of(theirs == ball) + SAMPLED_AT
            assert centre_of(ours == ball) == pytest.approx(expected, abs=0.5)
            # Theirs is a polyhedron inside the sphere; ours counts every pixel that it touches.
            radius, their_radius = (math.sqrt(np.sum(s == ball) / math.pi) for s in (ours, theirs))
            assert radius == pytest.approx(their_radius, abs=1)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_same_ball_is_on_top(stage, simulator, scenario):
    scene = simulator.sequence(scenario, 3, 1, 4).scene.model_copy(update={"radius_m": 0.225})
    generator = np.random.default_rng(4)
    for _ in range(6):
        heights = generator.permutation([0.9, 1.2, 1.5])
        positions = np.stack([*generator.uniform(-0.25, 0.25, (2, 3)), heights], axis=1)
        theirs, ours = seen_by_pybullet(stage, scene, positions), owners(scene, positions)
        both = (theirs >= 0) & (ours >= 0)
        assert both.sum() > 400
        # They differ along edges by that half pixel alone.
        assert np.mean(theirs[both] == ours[both]) > 0.92
        top = int(np.argmax(heights))
        column, row = camera_for(scenario, SIZE).project(positions[top]).astype(int)
        assert theirs[row, column] == top
