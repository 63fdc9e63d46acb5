"""Balls on tables, against closed forms: sliding, rolling, slopes, cushions, impacts, energy."""

import math

import numpy as np
import pytest

from rollcast.errors import SceneParametersError, SceneRejectedError
from rollcast.scene import MAX_OBJECTS, Scene
from rollcast.simulation.physics import GRAVITY_M_S2, Material
from rollcast.surfaces import Table, surface_of
from rollcast.trajectory import FRAME_RATE_HZ
from tests.rollcast.simulation.lab import Motion, run

RADIUS = 0.05
LOSSLESS = {"friction": 0.2, "rolling_resistance": 0.0, "damping": 0.0}
WALLS, OPEN = (-1.0, -1.0, 1.0, 1.0), (-5.0, -5.0, 5.0, 5.0)


def table(
    positions: list[tuple[float, float]],
    velocities: list[tuple[float, float]],
    *,
    slope: tuple[float, float] = (0.0, 0.0),
    walls: tuple[float, float, float, float] = OPEN,
    **fields: object,
) -> Scene:
    """A scene with balls that touch the table at these points, moving along it."""
    surface = Table(slope, walls)
    contacts = [surface.contact_at(x, y) for x, y in positions]
    along = [(vx, vy, slope[0] * vx + slope[1] * vy) for vx, vy in velocities]
    return Scene.model_validate(
        {
            "scenario": "table",
            "seed": 0,
            "textured": False,
            "radius_m": RADIUS,
            "rotation_rad": 0.0,
            "slope": slope,
            "walls_m": walls,
            "positions_m": tuple(
                tuple(np.asarray(c.point) + RADIUS * np.asarray(c.normal)) for c in contacts
            ),
            "velocities_m_s": tuple(along),
            "orientations_xyzw": ((0.0, 0.0, 0.0, 1.0),) * len(positions),
            **fields,
        }
    )


def moved(world, start: Scene, frames: int) -> Motion:
    return run(world(Material()), start, frames)


def velocity(motion: Motion, frame: int, ball: int = 0) -> np.ndarray:
    """Mean velocity over the frame that begins at ``frame``."""
    return (motion.centres[frame + 1, ball] - motion.centres[frame, ball]) * FRAME_RATE_HZ


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.4])
def test_a_sliding_ball_rolls_with_five_sevenths_of_its_speed_in_the_end(world, friction):
    speed = 2.0
    start = table([(-1, 0)], [(speed, 0)], **{**LOSSLESS, "friction": friction})
    motion = moved(world, start, 80)
    rolls_at_s = 2 * speed / (7 * friction * GRAVITY_M_S2)
    sliding, after = motion.times < rolls_at_s, motion.times > rolls_at_s + 0.05
    expected = speed - friction * GRAVITY_M_S2 * motion.times[sliding]
    np.testing.assert_allclose(motion.speeds[sliding, 0], expected, rtol=1e-6)
    np.testing.assert_allclose(motion.speeds[after, 0], 5 / 7 * speed, rtol=1e-6)


def test_a_ball_that_starts_rolling_keeps_its_speed(world):
    start = table([(-1, 0)], [(2.0, 0)], spins_rad_s=((0.0, 2.0 / RADIUS, 0.0),), **LOSSLESS)
    motion = moved(world, start, 40)
    np.testing.assert_allclose(motion.speeds, 2.0, rtol=1e-6)


def test_backspin_stops_a_ball_and_brings_it_back(world):
    """Sliding ends with (5 v_0 + 2 r w_0) / 7, w_0 counted positive where it rolls forwards."""
    speed, spin = 1.0, -4.0 / RADIUS
    start = table([(0, 0)], [(speed, 0)], spins_rad_s=((0.0, spin, 0.0),), **LOSSLESS)
    motion = moved(world, start, 120)
    expected = (5 * speed + 2 * RADIUS * spin) / 7
    assert expected < 0
    np.testing.assert_allclose(velocity(motion, 118), [expected, 0, 0], atol=1e-5)


@pytest.mark.parametrize("resistance", [0.005, 0.05])
def test_rolling_resistance_slows_evenly(world, resistance):
    fields = {**LOSSLESS, "rolling_resistance": resistance}
    start = table([(-1, 0)], [(1.0, 0)], spins_rad_s=((0.0, 1.0 / RADIUS, 0.0),), **fields)
    motion = moved(world, start, 40)
    slowing = (motion.speeds[5, 0] - motion.speeds[40, 0]) / (35 / FRAME_RATE_HZ)
    assert slowing == pytest.approx(5 / 7 * resistance * GRAVITY_M_S2, rel=1e-3)


@pytest.mark.parametrize("slope", [(0.05, 0.0), (0.0, -0.1), (0.04, 0.03)])
def test_a_rolling_ball_accelerates_down_a_slope_by_five_sevenths_of_gravitys_part(world, slope):
    start = table([(0, 0)], [(0, 0)], slope=slope, **LOSSLESS)
    motion = moved(world, start, 40)
    length = math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    downhill = np.array([-slope[0], -slope[1], -(slope[0] ** 2 + slope[1] ** 2)]) / length
    acceleration = 5 / 7 * GRAVITY_M_S2 * downhill / length
    time_s = 40 / FRAME_RATE_HZ
    np.testing.assert_allclose(
        motion.centres[40, 0] - motion.centres[0, 0], 0.5 * acceleration * time_s**2, rtol=5e-3,
        atol=1e-6,
    )  # fmt: skip


@pytest.mark.parametrize("restitution", [0.5, 0.75, 0.95])
def test_a_smooth_cushion_reflects_with_its_restitution(world, restitution):
    fields = {**LOSSLESS, "friction": 0.01, "wall_restitution": restitution, "wall_friction": 0.0}
    start = table([(0.8, 0)], [(2.0, 1.0)], walls=WALLS, **fields)
    motion = moved(world, start, 10)
    before, after = velocity(motion, 0), velocity(motion, 8)
    drag = 0.01 * GRAVITY_M_S2 * 10 / FRAME_RATE_HZ
    assert after[0] == pytest.approx(-restitution * before[0], abs=2 * drag)
    assert after[1] == pytest.approx(before[1], abs=2 * drag)
    assert motion.centres[:, 0, 0].max() <= 1.0 - RADIUS + 1e-3


@pytest.mark.parametrize("friction", [0.05, 0.2])
def test_a_rough_cushion_throws_the_ball(world, friction):
    """Coulomb: the change along the wall is at most mu (1 + e) v_n, or 2/7 of what slides."""
    restitution, normal_speed, along_speed = 0.8, 2.0, 1.0
    fields = {**LOSSLESS, "friction": 0.01, "wall_restitution": restitution}
    start = table(
        [(0.8, 0)], [(normal_speed, along_speed)], walls=WALLS, wall_friction=friction, **fields
    )
    motion = moved(world, start, 10)
    thrown = velocity(motion, 0)[1] - velocity(motion, 8)[1]
    expected = min(friction * (1 + restitution) * normal_speed, 2 / 7 * along_speed)
    assert thrown == pytest.approx(expected, abs=0.03)
    # The wall turns the ball about the vertical by the same impulse: 5/2 of it per radius.
    assert abs(motion.spins[9, 0, 2]) == pytest.approx(2.5 * thrown / RADIUS, rel=0.1)


@pytest.mark.parametrize("restitution", [0.7, 0.95])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_a_head_on_impact_of_two_masses(world, restitution, ratio):
    fields = {**LOSSLESS, "friction": 0.01, "ball_friction": 0.01}
    start = table(
        [(-0.3, 0), (0.3, 0)], [(2.0, 0), (0.0, 0)],
        mass_ratios=(ratio, 1.0), ball_restitution=restitution, **fields,
    )  # fmt: skip
    motion = moved(world, start, 16)
    speed = velocity(motion, 0)[0]
    expected = [
        (ratio - restitution) / (ratio + 1) * speed, (1 + restitution) * ratio / (ratio + 1) * speed
    ]  # fmt: skip
    # The ground's friction slows both balls by mu g t.
    drag = 0.01 * GRAVITY_M_S2 * 16 / FRAME_RATE_HZ
    measured = [velocity(motion, 14, ball)[0] for ball in (0, 1)]
    np.testing.assert_allclose(measured, expected, atol=2 * drag)


def test_no_table_gains_energy(world, simulator):
    for seed in range(4):
        start = simulator.sequence("table", 3, seed, 4).scene
        start = start.model_copy(update={"mass_ratios": None})
        motion = moved(world, start, 120)
        allowed = 1e-3 * (motion.energies[0] - motion.energies.min()) + 1e-4
        assert np.diff(motion.energies).max() < allowed


@pytest.mark.parametrize("objects", [1, 2, MAX_OBJECTS])
def test_drawn_tables_are_as_promised(simulator, objects):
    """Balls start clear of each other and within the cushions, and stay there."""
    for seed in range(3):
        sequence = simulator.sequence("table", objects, seed, 60, start_step=0)
        scene, centres = sequence.scene, sequence.trajectory.positions_m
        assert scene.objects == objects
        assert (np.abs(centres[0, :, :2]) < 1.25).all()
        surface = surface_of(scene)
        assert all(surface.clears(centre, scene.radius_m) for centre in scene.positions_m)
        left, bottom, right, top = scene.walls_m
        room = scene.radius_m - 0.02
        assert (centres[..., 0] > left + room).all()
        assert (centres[..., 0] < right - room).all()
        assert (centres[..., 1] > bottom + room).all()
        assert (centres[..., 1] < top - room).all()


def test_some_balls_of_many_rest(simulator):
    speeds = np.array(
        [
            np.linalg.norm(simulator.sequence("table", 4, seed, 4).scene.velocities_m_s, axis=1)
            for seed in range(8)
        ]
    )
    assert (speeds[:, 0] > 0).all()
    assert 0.2 < (speeds[:, 1:] == 0).mean() < 0.8


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"axis_ratio": 0.5}, "'table' has no axis_ratio"),
        ({"walls_m": (0.0, 0.0, 0.05, 1.0)}, "must leave room"),
        ({"slope": (0.5, 0.0)}, "less than or equal to 0.2"),
        ({"mass_ratios": (1.0, 2.0)}, "mass_ratios has 2 entries for 1 balls"),
    ],
)
def test_a_table_that_cannot_be_is_refused_with_the_reason(simulator, fields, reason):
    with pytest.raises(SceneParametersError, match=reason):
        simulator.sequence("table", 1, 0, 4, parameters=fields)


def test_a_table_without_room_for_its_balls_is_rejected(simulator):
    small = {"walls_m": (0.0, 0.0, 0.35, 0.35), "radius_m": 0.15}
    with pytest.raises(SceneRejectedError, match="clear of"):
        simulator.sequence("table", 2, 0, 4, parameters=small)


def test_other_materials_slow_balls_of_every_scenario(world, simulator):
    """Rolling resistance may be set in the paper's scenarios too."""
    for scenario in ("hemisphere", "heightfield"):
        usual = simulator.sequence(scenario, 1, 3, 4).scene
        slow = usual.model_copy(update={"rolling_resistance": 0.2})
        energies = [moved(world, one, 60).energies[-1] for one in (slow, usual)]
        assert energies[0] < energies[1]
