"""A ball on a plane, against closed forms."""

import numpy as np
import pybullet
import pytest

from rollcast.simulation.physics import GRAVITY_M_S2, Material
from tests.rollcast.simulation.lab import FRICTIONLESS, LOSSLESS, FlatGround, Motion, run, scene

FRICTION = LOSSLESS.friction**2
"""Of ball and ground together: Bullet multiplies the two."""

RADII = [0.04, 0.225]
DIRECTIONS = [0, 30, 135, 270]


def launch(world, speed: float, radius: float, frames: int, direction: float = 0) -> Motion:
    """Push a ball that does not turn yet over flat ground."""
    angle = np.radians(direction)
    velocity = (speed * np.cos(angle), speed * np.sin(angle), 0)
    return run(world, scene([(0, 0, radius)], [velocity], radius=radius), frames, FlatGround())


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_sliding_ball_rolls_in_the_end_with_five_sevenths_of_its_speed(world, radius, direction):
    speed = 2.0
    motion = launch(world(LOSSLESS), speed, radius, 80, direction)
    rolls = 2 * speed / (7 * FRICTION * GRAVITY_M_S2)
    sliding = motion.times < rolls
    np.testing.assert_allclose(
        motion.speeds[sliding, 0],
        speed - FRICTION * GRAVITY_M_S2 * motion.times[sliding],
        rtol=1e-6,
    )
    after = motion.times > rolls + 0.05
    np.testing.assert_allclose(motion.speeds[after, 0], 5 / 7 * speed, rtol=1e-6)


def test_a_small_fast_ball_rolls_as_a_large_slow_one_does(world):
    motion = launch(world(LOSSLESS), 10, 0.04, 80)
    assert motion.speeds[-1, 0] == pytest.approx(5 / 7 * 10)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_rolling_ball_keeps_speed_and_direction_and_turns_without_slip(world, radius, direction):
    motion = launch(world(LOSSLESS), 2.0, radius, 80, direction)
    rolling = motion.centres[20:, 0]
    velocities = np.diff(rolling, axis=0) * 40
    np.testing.assert_allclose(velocities - velocities[0], 0, atol=1e-6)
    # Without slip the contact point rests: v = spin x radius upwards.
    surface_speed = np.cross(motion.spins[21:, 0], [0, 0, radius])
    np.testing.assert_allclose(surface_speed, velocities, atol=1e-5)


def test_orientation_follows_the_spin(world):
    """Between frames the body turns about its angular velocity, by so much in 1/40 s."""
    one = world(LOSSLESS)
    launch(one, 2.0, 0.225, 40, direction=30)
    before = one.state()
    one.step_frame()
    after = one.state()
    inverse = np.multiply(before.orientations[0], (-1, -1, -1, 1)).tolist()
    _, turn = pybullet.multiplyTransforms((0, 0, 0), after.orientations[0], (0, 0, 0), inverse)
    axis, angle = pybullet.getAxisAngleFromQuaternion(turn)
    np.testing.assert_allclose(np.multiply(axis, angle * 40), before.spins[0], atol=1e-3)


def test_a_ball_without_friction_slides_on_for_ever_and_does_not_turn(world):
    motion = launch(world(FRICTIONLESS), 2.0, 0.225, 80)
    np.testing.assert_allclose(motion.speeds, 2.0, rtol=1e-9)
    np.testing.assert_array_equal(motion.spins, 0)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("resistance", [0.02, 0.05])
def test_rolling_resistance_slows_evenly(world, radius, direction, resistance):
    """A torque of C m g r on a rolling ball takes (5/7) C g off its speed every second."""
    material = Material(rolling_resistance=resistance, damping=0)
    motion = launch(world(material), 2.0, radius, 80, direction)
    slowing = (motion.speeds[20, 0] - motion.speeds[80, 0]) / 1.5
    assert slowing == pytest.approx(5 / 7 * resistance * GRAVITY_M_S2, rel=1e-4)


def test_rolling_resistance_stops_a_ball_for_good(world):
    motion = launch(world(Material(rolling_resistance=0.2, damping=0)), 0.5, 0.225, 80)
    np.testing.assert_allclose(motion.speeds[-20:], 0, atol=1e-6)
    np.testing.assert_allclose(motion.centres[-20:] - motion.centres[-1], 0, atol=1e-6)


@pytest.mark.parametrize("damping", [0.02, 0.3])
@pytest.mark.parametrize("speed", [0.1, 5.0])
def test_damping_slows_a_sliding_ball(world, damping, speed):
    """dv/dt = -d v (1 + v), so v / (1 + v) falls as exp(-d t)."""
    material = Material(friction=0, rolling_resistance=0, damping=damping)
    motion = launch(world(material), speed, 0.225, 80)
    share = speed / (1 + speed) * np.exp(-damping * motion.times)
    np.testing.assert_allclose(motion.speeds[:, 0], share / (1 - share), rtol=5e-3)


@pytest.mark.parametrize("radius", RADII)
def test_damping_slows_spin_as_well(world, radius):
    """Of a rolling ball: dv/dt = -d v (1 + c v) with c = 5/7 + 2/7 / r, from both equations."""
    damping = 0.02
    motion = launch(world(Material(rolling_resistance=0, damping=damping)), 2.0, radius, 80)
    speeds, times = motion.speeds[20:, 0], motion.times[:61]
    c = 5 / 7 + 2 / 7 / radius
    share = speeds[0] / (1 + c * speeds[0]) * np.exp(-damping * times)
    np.testing.assert_allclose(speeds, share / (1 - c * share), rtol=2e-3)


def test_resistance_without_friction_is_refused():
    with pytest.raises(ValueError, match="needs friction"):
        Material(friction=0, rolling_resistance=0.05)
