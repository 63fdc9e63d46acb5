"""The simulator restarted: from the truth it repeats it, from four exact positions nearly."""

import numpy as np
import pytest

from rollcast.camera import camera_for
from rollcast.simulation.recording import TEST_START
from rollcast.simulation.sampling import draw_scene, scene_generator
from rollcast.surfaces import HEIGHTFIELD_HALF_WIDTH_M
from tests.training.conftest import HEMISPHERE, SCENES
from training.baselines.oracle import Oracle
from training.data.shards import Source, load_recordings, simulate_split

HORIZON = 20


@pytest.fixture(scope="module")
def oracle():
    made = Oracle()
    yield made
    made.close()


def truth_of(recording):
    scenario = recording.scene.scenario
    window = recording.trajectory.window(TEST_START[scenario], 3 + HORIZON)
    return camera_for(scenario, 128).project(window.positions_m).swapaxes(0, 1), window


@pytest.mark.parametrize(("scenario", "objects"), [("hemisphere", 1), ("ellipsoid", 2)])
def test_from_the_true_state_it_repeats_the_truth(runs, oracle, scenario, objects):
    shards = simulate_split(Source(scenario, objects), "validation", SCENES, workers=2)
    for recording in load_recordings(shards)[:4]:
        positions, window = truth_of(recording)
        path = oracle.from_truth(recording.scene, TEST_START[scenario], HORIZON)
        np.testing.assert_allclose(path.positions, positions[:, 3:], atol=0.02)
        spins = window.angular_velocities_rad_s[3:].swapaxes(0, 1)
        np.testing.assert_allclose(path.angular_velocities, spins, atol=0.05)


def test_noise_costs_what_it_hides(runs, oracle):
    recordings = load_recordings(simulate_split(HEMISPHERE, "validation", SCENES, workers=2))
    errors = {0.0: [], 0.25: [], 1.0: []}
    for recording in recordings[:8]:
        positions, _ = truth_of(recording)
        generator = np.random.default_rng(recording.scene.seed)
        unit = generator.normal(size=(1, 4, 2))
        for noise, found in errors.items():
            seen = positions[:, :4] + noise * unit
            path = oracle.from_positions(recording.scene, seen, HORIZON)
            found.append(np.linalg.norm(path.positions - positions[:, 3:], axis=-1)[0])
    means = {noise: np.mean(found, axis=0) for noise, found in errors.items()}
    assert means[0.0][0] < 0.02
    assert means[0.0][-1] < means[0.25][-1] < means[1.0][-1]
    # t = 0 is better known than from its own noisy position alone.
    assert means[1.0][0] < np.sqrt(np.pi / 2)


def test_a_ball_that_noise_puts_into_a_wall_is_taken_to_touch_it(oracle):
    scene = draw_scene(
        "heightfield", 1, 7, scene_generator("heightfield", 1, 7), {}, lambda _: True
    )
    camera = camera_for("heightfield", 128)
    room = HEIGHTFIELD_HALF_WIDTH_M - scene.radius_m
    seen = camera.project(np.array([[[room + 0.01, 0.1 * k, 0.0] for k in range(4)]]))
    path = oracle.from_positions(scene, seen, HORIZON)
    assert np.isfinite(path.positions).all()
    np.testing.assert_allclose(path.positions[0, 0], seen[0, 3], atol=2.0)
