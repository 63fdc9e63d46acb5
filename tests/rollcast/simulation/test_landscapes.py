"""A ball on a heightfield."""

import math

import numpy as np
import pytest

from rollcast.simulation.physics import GRAVITY_M_S2, Material
from rollcast.surfaces import Heightfield
from tests.rollcast.simulation.lab import FRICTIONLESS, LOSSLESS, Motion, run, scene

RADIUS_M = 0.225


def wander(world, scale: float, seed: int) -> tuple[Heightfield, Motion]:
    """Start a ball somewhere on a landscape without walls; stop before it leaves the view."""
    generator = np.random.default_rng(seed)
    ground = Heightfield(scale, tuple(generator.uniform(-2, 2, 2)), generator.uniform(-3, 3))
    x, y = generator.uniform(-0.6, 0.6, 2)
    centre = (x, y, ground.resting_height(x, y, RADIUS_M))
    normal = np.array(ground.contacts(centre, RADIUS_M)[0].normal)
    velocity = np.append(generator.uniform(-2, 2, 2), 0)
    velocity -= np.dot(velocity, normal) * normal
    motion = run(world, scene([centre], [tuple(velocity)]), 60, ground)
    beyond = np.abs(motion.centres[:, 0, :2]).max(axis=1) > 1.2
    seen = int(np.argmax(beyond)) if beyond.any() else len(beyond)
    return ground, Motion(*(part[:seen] for part in motion))


@pytest.mark.parametrize("scale", [0.5, 0.7])
@pytest.mark.parametrize("seed", range(4))
def test_energy_never_rises(world, scale, seed):
    _, motion = wander(world(Material()), scale, seed)
    assert len(motion.energies) > 20
    assert np.diff(motion.energies).max() <= 1e-4
    assert motion.energies[-1] < motion.energies[0]


@pytest.mark.parametrize("material", [LOSSLESS, FRICTIONLESS])
@pytest.mark.parametrize("seed", range(4))
def test_without_resistance_energy_rises_by_the_lag_of_the_step_alone(world, material, seed):
    """Velocities lag half a step behind positions: g times the fall of one step, about."""
    _, motion = wander(world(material), 0.7, seed)
    rises = motion.energies - np.minimum.accumulate(motion.energies)
    assert rises.max() <= GRAVITY_M_S2 * motion.speeds.max() / 360


@pytest.mark.parametrize("scale", [0.35, 0.5, 0.7])
def test_the_ball_never_sinks_into_the_ground(world, scale):
    ground, motion = wander(world(Material()), scale, 1)
    steps = np.arange(-RADIUS_M, RADIUS_M, 0.01)
    dx, dy = np.meshgrid(steps, steps)
    for x, y, z in motion.centres[:, 0]:
        heights, _ = ground.height_and_normal(x + dx, y + dy)
        nearest = np.sqrt(dx**2 + dy**2 + (heights - z) ** 2).min()
        assert nearest > RADIUS_M - 3e-3


@pytest.mark.parametrize("material", [LOSSLESS, FRICTIONLESS])
def test_small_oscillation_in_a_hollow(world, material):
    """Along each principal direction omega^2 = share g k / (1 - k r), k the ground's curvature."""
    ground = Heightfield(0.7, (0.0, 0.0), 0.0)
    x, y = np.meshgrid(np.linspace(-1, 1, 201), np.linspace(-1, 1, 201), indexing="ij")
    heights, _ = ground.height_and_normal(x, y)
    lowest = np.unravel_index(np.argmin(heights), heights.shape)
    bottom = np.array([x[lowest], y[lowest]])
    h = 1e-4
    for _ in range(20):
        slope, curvature = _slope_and_curvature(ground, bottom, h)
        bottom = bottom - np.linalg.solve(curvature, slope)
    curvatures, directions = np.linalg.eigh(curvature)
    share = 5 / 7 if material == LOSSLESS else 1.0
    for k, direction in zip(curvatures, directions.T, strict=True):
        foot = ground.contact_at(*(bottom + 0.01 * direction))
        centre = np.add(foot.point, np.multiply(RADIUS_M, foot.normal))
        motion = run(world(material), scene([tuple(centre)]), 160, ground)
        along = (motion.centres[:, 0, :2] - bottom) @ direction
        crossings = np.flatnonzero((along[:-1] < 0) != (along[1:] < 0))
        places = crossings + along[crossings] / (along[crossings] - along[crossings + 1])
        half_period = np.diff(places[[0, -1]])[0] / (len(places) - 1) / 40
        expected = share * GRAVITY_M_S2 * k / (1 - k * RADIUS_M)
        assert (math.pi / half_period) ** 2 == pytest.approx(expected, rel=0.02)


def _slope_and_curvature(
    ground: Heightfield, place: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Slope and Hessian of the height by finite differences."""
    shifts = h * np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    z = ground.height_and_normal(*(place + shifts).T)[0].reshape(3, 3)
    slope = np.array([z[2, 1] - z[0, 1], z[1, 2] - z[1, 0]]) / (2 * h)
    xx, yy = z[2, 1] - 2 * z[1, 1] + z[0, 1], z[1, 2] - 2 * z[1, 1] + z[1, 0]
    xy = (z[2, 2] - z[2, 0] - z[0, 2] + z[0, 0]) / 4
    return slope, np.array([[xx, xy], [xy, yy]]) / h**2
