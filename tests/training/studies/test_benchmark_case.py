"""Which scenes the studies' methods are tested on."""

from itertools import pairwise

import numpy as np
import pytest

from rollcast.scene import LARGE_RADIUS_M
from rollcast.simulation import Simulator
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import FIRST_FORECAST_FRAME, Trajectory
from training.data.shards import STORED_FRAMES, Recording, SceneOverride, Source
from training.studies.benchmark_case import COLLISION_STEP, SceneFilter, before_collision
from training.studies.conditions import NOISE_SCALES

MEETING = 150
"""Frame after which two balls collide."""


@pytest.fixture(scope="module")
def simulator():
    simulator = Simulator()
    yield simulator
    simulator.close()


def test_slower_scenes_are_the_usual_ones_but_for_their_speed(simulator):
    usual = Source("hemisphere").sequence(simulator, 3)
    slower = Source("hemisphere", override=SceneOverride("slow", speed=0.5)).sequence(simulator, 3)
    assert usual is not None
    assert slower is not None
    np.testing.assert_allclose(
        2 * np.array(slower.scene.velocities_m_s), usual.scene.velocities_m_s
    )
    assert slower.scene.positions_m == usual.scene.positions_m
    assert len(slower.trajectory.positions_m) == STORED_FRAMES


def test_what_leaves_the_bowl_at_its_speed_is_left_out(simulator):
    thrice = Source("hemisphere", override=SceneOverride("fast", speed=1.5))
    left = [thrice.sequence(simulator, seed) for seed in range(3)]
    assert None in left


def test_changed_fields_are_fixed(simulator):
    change = SceneOverride("narrow", (("radius_m", 0.15), ("axis_ratio", 0.4)))
    source = Source("ellipsoid", override=change)
    made = source.sequence(simulator, 3)
    assert made is not None
    assert (made.scene.radius_m, made.scene.axis_ratio) == (0.15, 0.4)
    assert source.name == "ellipsoid-1-narrow"


def test_every_ground_lies_in_one_part_by_difficulty(simulator):
    scene = simulator.sequence("heightfield", 1, 1, 1, 0).scene
    parts = [SceneFilter("noise_scale", low, high) for low, high in pairwise(NOISE_SCALES)]
    for scale in np.linspace(0.2, 0.699, 20):
        other = scene.model_copy(update={"noise_scale": float(scale)})
        assert sum(part.holds(other) for part in parts) == 1


def two_balls(simulator, closest_m: float) -> Recording:
    """Two balls that run at each other and back; their centres come as close as that."""
    scene = simulator.sequence("ellipsoid", 2, 1, 1, 0).scene
    away = closest_m + 0.05 * np.abs(np.arange(STORED_FRAMES) - MEETING - 0.5)
    centres = np.zeros((STORED_FRAMES, 2, 3))
    centres[:, 1, 0] = away
    still = np.zeros((STORED_FRAMES, 2, 4))
    return Recording(scene, Trajectory(centres, still, np.zeros((STORED_FRAMES, 2, 3))))


def test_a_collision_comes_ten_steps_after_the_start(simulator):
    whole = two_balls(simulator, 2 * LARGE_RADIUS_M)
    cut = before_collision(whole, horizon=30)
    assert cut is not None
    step = TEST_START["ellipsoid"] + FIRST_FORECAST_FRAME + COLLISION_STEP
    np.testing.assert_array_equal(
        cut.trajectory.positions_m[step], whole.trajectory.positions_m[MEETING]
    )


def test_balls_that_turn_back_before_they_touch_do_not_collide(simulator):
    assert before_collision(two_balls(simulator, 2 * LARGE_RADIUS_M + 0.06), horizon=30) is None


def test_a_collision_too_late_for_a_forecast_is_left_out(simulator):
    whole = two_balls(simulator, 2 * LARGE_RADIUS_M)
    assert before_collision(whole, horizon=STORED_FRAMES - MEETING + COLLISION_STEP + 1) is None
