"""A ball in a bowl: small oscillations, energy, convergence."""

import numpy as np
import pytest

from rollcast.simulation.physics import GRAVITY_M_S2, Material
from tests.rollcast.simulation.lab import (
    FRICTIONLESS,
    LOSSLESS,
    angular_frequency,
    at_rest_in_bowl,
    distance_from_bowl_centre,
    run,
)

GAITS = [pytest.param(LOSSLESS, 5 / 7, id="rolling"), pytest.param(FRICTIONLESS, 1.0, id="sliding")]
RADII = [0.04, 0.225]


@pytest.mark.parametrize(("material", "share"), GAITS)
@pytest.mark.parametrize("radius", RADII)
def test_small_oscillation_in_the_hemisphere(world, material, share, radius):
    """omega^2 = (5/7) g / (R - r) for a rolling ball, g / (R - r) for one that slides."""
    azimuth = 0.3
    motion = run(world(material), at_rest_in_bowl(0.05, azimuth, radius=radius), 240)
    along = motion.centres[:, 0] @ [np.cos(azimuth), np.sin(azimuth), 0]
    across = motion.centres[:, 0] @ [-np.sin(azimuth), np.cos(azimuth), 0]
    expected = share * GRAVITY_M_S2 / (1 - radius)
    # The pendulum's own correction, amplitude^2 / 8 of omega^2, is 0.03 %.
    assert angular_frequency(along) ** 2 == pytest.approx(expected, rel=1e-3)
    np.testing.assert_allclose(across, 0, atol=1e-9)


@pytest.mark.parametrize(("material", "share"), GAITS)
@pytest.mark.parametrize("ratio", [0.6, 0.8])
@pytest.mark.parametrize("axis", ["short", "long"])
def test_small_oscillation_along_each_axis_of_an_ellipsoid(world, material, share, ratio, axis):
    """At the bottom the ellipsoid curves with radius a^2 along its short axis and 1 along y."""
    rotation, radius = 0.7, 0.225
    azimuth, curvature_radius = (0, ratio**2) if axis == "short" else (np.pi / 2, 1)
    start = at_rest_in_bowl(0.03, azimuth, radius=radius, axis_ratio=ratio, rotation=rotation)
    motion = run(world(material), start, 240)
    turn = rotation + azimuth
    along = motion.centres[:, 0] @ [np.cos(turn), np.sin(turn), 0]
    across = motion.centres[:, 0] @ [-np.sin(turn), np.cos(turn), 0]
    expected = share * GRAVITY_M_S2 / (curvature_radius - radius)
    assert angular_frequency(along) ** 2 == pytest.approx(expected, rel=3e-3)
    np.testing.assert_allclose(across, 0, atol=1e-9)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_energy_never_rises(world, radius, ratio):
    start = at_rest_in_bowl(1.3, 0.8, radius=radius, axis_ratio=ratio)
    start = start.model_copy(update={"velocities_m_s": ((2.0, -3.0, 0.0),)})
    motion = run(world(Material()), start, 300)
    # At rest the contact's correction may lift the ball by some 1e-8 m.
    assert np.diff(motion.energies).max() <= 1e-6
    fallen = motion.energies[0] - motion.energies
    assert fallen[-1] > 0.5 * fallen.max() > 0


@pytest.mark.parametrize("material", [LOSSLESS, FRICTIONLESS])
def test_without_resistance_energy_is_kept_but_for_the_lag_of_the_step(world, material):
    """Velocities lag half a step behind positions, so energy swings by a share of the step."""
    motion = run(world(material), at_rest_in_bowl(np.radians(35), 0.3), 400)
    swing = motion.energies[0] - GRAVITY_M_S2 * 0.225
    assert np.abs(motion.energies - motion.energies[0]).max() < 0.02 * swing
    finer = run(world(material, 36), at_rest_in_bowl(np.radians(35), 0.3), 400)
    assert np.abs(finer.energies - finer.energies[0]).max() < 0.005 * swing


@pytest.mark.parametrize("material", [LOSSLESS, FRICTIONLESS])
def test_the_loss_of_energy_falls_at_least_with_the_square_of_the_step(world, material):
    """Measured where the ball turns, for there all energy is height."""

    def loss(steps_per_frame: int) -> float:
        motion = run(world(material, steps_per_frame), at_rest_in_bowl(np.radians(40), 0.3), 400)
        z = motion.centres[:, 0, 2]
        tops = np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) + 1
        slope, bend = (z[tops + 1] - z[tops - 1]) / 2, z[tops + 1] - 2 * z[tops] + z[tops - 1]
        heights = z[tops] - slope**2 / (2 * bend)
        return (heights[0] - heights[8]) / heights[0]

    coarse, middle, fine = loss(5), loss(10), loss(20)
    assert 0 < middle < 1.5e-3
    assert coarse > 3.5 * middle
    assert middle > 3.5 * fine > 0


def test_the_ball_keeps_to_the_surface_better_as_the_step_shrinks(world):
    def depth(steps_per_frame: int) -> float:
        start = at_rest_in_bowl(1.2, 0.3)
        motion = run(world(LOSSLESS, steps_per_frame), start, 80)
        return distance_from_bowl_centre(motion.centres).max() - (1 - start.radius_m)

    assert depth(9) < 1e-3
    assert depth(9) > 3 * depth(18) > 9 * (depth(36) - 1e-5)


def test_a_ball_comes_to_rest_at_the_bottom(world):
    """Paper: "Due to friction, at the end of each experiment the ball rests at the bottom"."""
    start = at_rest_in_bowl(1.0, 0.3, axis_ratio=0.8)
    motion = run(world(Material()), start, 1200)
    np.testing.assert_allclose(motion.speeds[-40:], 0, atol=1e-3)
    height = motion.centres[-1, 0, 2] - 0.225
    # Rolling resistance holds the ball wherever the slope is below its coefficient.
    assert height < Material().rolling_resistance ** 2
