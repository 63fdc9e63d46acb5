"""Balls against walls, against each other, and falling to the ground."""

import numpy as np
import pytest

from rollcast.camera import HEIGHTFIELD_HALF_WIDTH_M
from rollcast.simulation.physics import BALL_RESTITUTION, GRAVITY_M_S2, Material
from rollcast.trajectory import FRAME_RATE_HZ
from tests.rollcast.simulation.lab import FRICTIONLESS, LOSSLESS, FlatGround, run, scene

RADII = [0.04, 0.225]
SPEEDS = [1.7, 2.3, 3.7]


def velocities(centres: np.ndarray) -> np.ndarray:
    """Mean horizontal velocities over frames: those of the moment where nothing acts."""
    return np.diff(centres[..., :2], axis=0) * FRAME_RATE_HZ


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("speed", SPEEDS)
def test_walls_are_elastic(world, radius, speed):
    start = scene([(0.6, 0, radius)], [(speed, 0.4, 0)], radius=radius, walls=True)
    measured = velocities(run(world(FRICTIONLESS), start, 20, FlatGround()).centres[:, 0])
    before, after = measured[0], measured[-1]
    assert after[1] == pytest.approx(before[1], abs=1e-9)
    # A ball that a step leaves within 1e-5 m of the wall loses as much in the next.
    assert after[0] == pytest.approx(-before[0], abs=1e-5 * 360 + 1e-4)


@pytest.mark.parametrize("x", [-1, 0, 1])
@pytest.mark.parametrize("y", [-1, 0, 1])
def test_walls_stand_around_the_cameras_view_without_friction(world, x, y):
    """A rolling ball is sent back along both axes and keeps its spin where it meets a wall."""
    radius = 0.225
    start = scene([(0, 0, radius)], [(3 * x, 3 * y, 0)], radius=radius, walls=True)
    motion = run(world(Material()), start, 200, FlatGround())
    reach = np.abs(motion.centres[:, 0, :2]).max(axis=0) + radius
    # Between two steps a ball of 3 m/s goes 8 mm.
    np.testing.assert_allclose(reach[[x != 0, y != 0]], HEIGHTFIELD_HALF_WIDTH_M, atol=0.02)
    np.testing.assert_allclose(motion.centres[:, 0, 2], radius, atol=2e-5)
    np.testing.assert_allclose(motion.spins[:, 0, 2], 0, atol=1e-9)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("offset", [0, 0.4, 0.9])
@pytest.mark.parametrize("speed", [1.0, 3.0, 8.0])
def test_two_balls_keep_momentum_and_lose_relative_speed(world, radius, offset, speed):
    """Without friction only the velocities along the line of centres change."""
    start = scene(
        [(-0.5, 0, radius), (0.5, offset * radius, radius)],
        [(speed, 0, 0), (-speed / 2, 0, 0)],
        radius=radius,
    )
    measured = velocities(run(world(FRICTIONLESS), start, 40, FlatGround()).centres)
    before, after = measured[0], measured[-1]
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-9)
    normal = (after - before)[1] / np.linalg.norm((after - before)[1])
    approach, parting = (before[0] - before[1]) @ normal, (after[1] - after[0]) @ normal
    assert parting / approach == pytest.approx(BALL_RESTITUTION, abs=1e-3)
    sideways = before[0] - before[1] - approach * normal
    np.testing.assert_allclose(after[0] - after[1] + parting * normal, sideways, atol=1e-6)
    # The line of centres at the impact lies ``offset`` radii aside; a step may overshoot it.
    assert abs(normal[1]) == pytest.approx(offset / 2, abs=0.05 + speed / 360 / radius)


def test_impacts_with_friction_keep_momentum_too(world):
    radius = 0.225
    start = scene(
        [(-0.3, 0, radius), (0.3, 0.1, radius)], [(1.0, 0.2, 0), (-0.5, 0, 0)], radius=radius
    )
    smooth_ground = Material(friction=0.5, rolling_resistance=0, damping=0)
    motion = run(world(smooth_ground), start, 8, FlatGround())
    gaps = np.linalg.norm(motion.centres[:, 0] - motion.centres[:, 1], axis=1) - 2 * radius
    hit = int(np.argmax(np.diff(gaps) > 0))
    # In one frame the ground's own friction changes momentum by no more than mu g dt a ball.
    change = velocities(motion.centres)[hit + 1].sum(axis=0) - velocities(motion.centres)[
        hit - 1
    ].sum(axis=0)
    allowed = 2 * 2 * 0.25 * GRAVITY_M_S2 / FRAME_RATE_HZ
    assert np.linalg.norm(change) < allowed


def test_each_ball_rests_on_its_own_ground(world):
    """The plane under one ball is no obstacle to another."""
    radius = 0.04
    start = scene([(-0.3, 0, radius), (0.3, 0.2, radius)], [(1, 0, 0), (-1, 0, 0)], radius=radius)
    alone = scene([(-0.3, 0, radius)], [(1, 0, 0)], radius=radius)
    together = run(world(LOSSLESS), start, 40, FlatGround())
    np.testing.assert_array_equal(
        together.centres[:, 0], run(world(LOSSLESS), alone, 40, FlatGround()).centres[:, 0]
    )


def test_a_ball_falls_freely_and_does_not_bounce(world):
    radius, height = 0.225, 1.0
    motion = run(world(FRICTIONLESS), scene([(0, 0, height)], [(1, 0, 0)]), 60, FlatGround())
    lands = np.sqrt(2 * (height - radius) / GRAVITY_M_S2)
    falling = motion.times < lands - 0.03
    t, step = motion.times[falling], 1 / 360
    expected = height - GRAVITY_M_S2 * t * (t + step) / 2
    np.testing.assert_allclose(motion.centres[falling, 0, 2], expected, atol=1e-9)
    np.testing.assert_allclose(velocities(motion.centres[:, 0])[:, 0], 1, atol=1e-9)
    landed = motion.centres[motion.times > lands + 0.03, 0, 2]
    assert landed.max() < radius + 1e-3
    assert landed[-1] == pytest.approx(radius, abs=2e-5)
