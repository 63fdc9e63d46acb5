"""Windows of other appearances: what the camera does to a picture, it does to the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from rollcast.simulation import Simulator
from rollcast.simulation.appearance import CameraPose, Sensor, draw_appearance
from training.data.appearance_mixture import (
    AppearanceMixture,
    lengths_of,
    planar_window,
    posed,
    restyled_window,
)
from training.data.painting.camera import posed_frames, posed_points, shaken, unposed_points
from training.data.painting.planar import draw_planar_scene, paint_planar_scene
from training.data.painting.sensor import through_sensor
from training.data.rest_height_map import resting_ground
from training.data.scene_cache import SceneCache
from training.data.shards import Recording
from training.data.windows import Symmetry, WindowAppearance, WindowMaker, collate
from training.networks.perception import scene_constants_of
from training.networks.recurrent import PerceptionOutput
from training.objectives.losses import PerceptionLoss

POSE = CameraPose(1.2, (3.0, -2.0), 0.5, (0.1, -0.05), 0.08)
HORIZON = 8
KINDS = ("hemisphere", "heightfield", "table")


@pytest.fixture(scope="module")
def maker() -> WindowMaker:
    simulator = Simulator()
    made = [simulator.sequence(kind, 1, 3, 60, 0) for kind in KINDS]
    simulator.close()
    recordings = [Recording(one.scene, one.trajectory) for one in made]
    plain = WindowMaker(recordings, None)
    scene_cache = SceneCache(
        np.stack([plain.renderer(k).empty for k in range(len(KINDS))]),
        np.stack([resting_ground(one.scene) for one in made]),
    )
    return WindowMaker(recordings, None, scene_cache, scene_targets=True)


def spot(image: np.ndarray) -> np.ndarray:
    """Centre of gravity of an image's light, continuous pixels."""
    weights = image.astype(float).sum(axis=-1)
    rows, columns = np.indices(weights.shape) + 0.5
    return np.array([(columns * weights).sum(), (rows * weights).sum()]) / weights.sum()


def a_spot(at: np.ndarray) -> np.ndarray:
    rows, columns = np.indices((128, 128)) + 0.5
    light = np.exp(-((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / 18)
    return np.repeat((255 * light).astype(np.uint8)[..., None], 3, axis=2)


def test_a_pose_is_undone():
    points = np.random.default_rng(0).uniform(20, 108, (50, 2))
    np.testing.assert_allclose(unposed_points(posed_points(points, POSE), POSE), points, atol=1e-2)


def test_points_go_where_the_picture_goes():
    at = np.array([80.0, 50.0])
    beyond = np.zeros((128, 128, 3), np.uint8)
    (moved,) = posed_frames(a_spot(at)[None], POSE, beyond, "plain")
    np.testing.assert_allclose(spot(moved), posed_points(at, POSE), atol=0.15)


def test_a_shaken_picture_moves_as_it_says():
    shift = np.array([0.6, -0.3])
    (moved,) = shaken(a_spot(np.array([70.0, 60.0]))[None], shift[None])
    np.testing.assert_allclose(spot(moved), [70.6, 59.7], atol=0.05)  # OpenCV counts in 1/32 px


def test_a_turned_camera_sees_the_turned_window(maker):
    window = maker.window(0, 5, HORIZON)
    turned = posed(window, CameraPose(rotation_rad=-math.pi / 2))
    expected = Symmetry(1, mirror=False).apply(window)
    np.testing.assert_allclose(turned.positions, expected.positions, atol=1e-6)
    np.testing.assert_allclose(turned.angular_velocities, expected.angular_velocities, atol=1e-6)
    assert turned.scene_targets is not None
    assert expected.scene_targets is not None
    np.testing.assert_allclose(
        turned.scene_targets.centres, expected.scene_targets.centres, atol=1e-6
    )
    known = ~np.isnan(turned.scene_targets.ground)
    assert known.mean() > 0.6
    difference = (turned.scene_targets.ground - expected.scene_targets.ground)[known]
    np.testing.assert_allclose(difference, 0, atol=1e-3)


def test_a_nearer_camera_sees_a_smaller_part_of_a_larger_ball(maker):
    window = maker.window(0, 5, HORIZON)
    near = posed(window, CameraPose(scale=1.25))
    assert window.scene_targets is not None
    assert near.scene_targets is not None
    half_width, radius = lengths_of(window.scene_targets.scene_constants)
    expected = scene_constants_of(half_width / 1.25, radius)
    np.testing.assert_allclose(near.scene_targets.scene_constants, expected)
    heights = near.scene_targets.centres[..., 2] / window.scene_targets.centres[..., 2]
    np.testing.assert_allclose(heights, 1.25)


def test_perspective_leaves_the_places_alone_known(maker):
    tilted = posed(maker.window(0, 5, HORIZON), CameraPose(tilt=(0.1, 0.0)))
    assert tilted.scene_targets is not None
    assert not np.isnan(tilted.scene_targets.centres[..., :2]).any()
    for unknown in (tilted.scene_targets.centres[..., 2], *tilted.scene_targets[1:]):
        assert np.isnan(unknown).all()


@pytest.mark.parametrize("index", range(len(KINDS)))
def test_the_truth_of_a_restyled_window_is_that_of_its_scene(maker, index):
    usual = maker.window(index, 5, HORIZON)
    windows = [
        restyled_window(np.random.default_rng(seed), maker, index, 5, HORIZON) for seed in range(12)
    ]
    still = [w for w in windows if np.allclose(w.positions[:, 0], usual.positions[:, 0])]
    assert still
    for window in still:
        np.testing.assert_allclose(window.positions, usual.positions)
        assert window.scene_targets is not None
        assert usual.scene_targets is not None
        np.testing.assert_array_equal(window.scene_targets.ground, usual.scene_targets.ground)
    assert len({window.frames.tobytes() for window in windows}) == len(windows)


def test_windows_are_functions_of_their_appearance(maker):
    for appearance in (
        WindowAppearance("planar", True, 4),
        WindowAppearance("restyled", False, 4),
        WindowAppearance("paper", True, 4),
    ):
        one, other = (
            AppearanceMixture().window(appearance, maker, 0, 5, HORIZON) for _ in range(2)
        )
        np.testing.assert_array_equal(one.frames, other.frames)
        np.testing.assert_array_equal(one.guidance.prompts, other.guidance.prompts)


def test_the_papers_look_stays_as_it_is(maker):
    window = AppearanceMixture().window(WindowAppearance("paper", False, 1), maker, 1, 5, HORIZON)
    np.testing.assert_array_equal(window.frames, maker.window(1, 5, HORIZON).frames)
    assert np.isnan(window.guidance.prompts).all()


def test_shares_of_looks_are_as_asked_for():
    generator = np.random.default_rng(0)
    drawn = [AppearanceMixture().draw(generator) for _ in range(2000)]
    shares = {
        kind: np.mean([appearance.kind == kind for appearance in drawn])
        for kind in ("paper", "planar")
    }
    assert shares["paper"] == pytest.approx(0.40, abs=0.04)
    planar = [appearance.prompted for appearance in drawn if appearance.kind == "planar"]
    assert np.mean(planar) == pytest.approx(0.5, abs=0.06)


def test_prompts_lie_near_the_ball_in_the_last_frame():
    for seed in range(30):
        window = planar_window(np.random.default_rng(seed), 1, prompted=True)
        assert window.guidance is not None
        away = np.linalg.norm(window.guidance.prompts - window.positions[:, 0])
        assert away <= max(2.5, window.guidance.radii[0] / 2)


def test_without_a_prompt_only_the_ball_that_is_meant_moves():
    generator = np.random.default_rng(7)
    for _ in range(60):
        scene = draw_planar_scene(generator, prompted=False)
        meant, *others = scene.balls
        assert not any(ball.moves for ball in others)
        assert meant.moves or not others


def test_balls_do_not_overlap_in_a_planar_scene():
    generator = np.random.default_rng(8)
    for _ in range(40):
        balls = draw_planar_scene(generator, prompted=True).balls
        for k, one in enumerate(balls):
            for other in balls[:k]:
                gaps = np.linalg.norm(np.subtract(one.path, other.path), axis=1)
                assert gaps.min() > one.radius + other.radius


def test_a_planar_ball_is_where_the_truth_says():
    generator = np.random.default_rng(9)
    checked = 0
    while checked < 10:
        scene = draw_planar_scene(generator, prompted=False)
        ball = scene.balls[0]
        if not ball.moves or ball.radius > 12 or np.ptp(ball.path, axis=0).max() < 8:
            continue
        lamp = replace(scene.appearance.lamp, shadow=0.0)
        appearance = replace(ball.appearance, pattern="plain", gloss=0.0)
        quiet = replace(scene.appearance, clutter=(), sensor=Sensor(), lamp=lamp)
        alone = replace(scene, appearance=quiet, balls=(replace(ball, appearance=appearance),))
        window = paint_planar_scene(alone)
        x, y = window.path[-1]
        if min(x, y, 128 - x, 128 - y) < ball.radius:
            continue
        differs = np.abs(window.frames[-1].astype(int) - window.frames[0])
        rows, columns = np.indices((128, 128)) + 0.5
        near = np.hypot(columns - x, rows - y) < ball.radius + 3
        far_from_first = np.hypot(columns - window.path[0][0], rows - window.path[0][1])
        mask = near & (far_from_first > ball.radius + 2)
        if mask.sum() < near.sum():
            continue
        np.testing.assert_allclose(spot(differs * mask[..., None]), (x, y), atol=0.6)
        checked += 1


def test_a_sensor_without_effects_changes_nothing():
    frames = np.random.default_rng(0).integers(0, 256, (4, 128, 128, 3), dtype=np.uint8)
    np.testing.assert_array_equal(through_sensor(frames, Sensor()), frames)


@pytest.mark.parametrize(
    "effect",
    [
        {"gains": (1.2, 1.0, 0.7)}, {"gamma": 1.5}, {"contrast": 0.5}, {"saturation": 0.0},
        {"hue_rad": 1.0}, {"vignette": 0.5}, {"reflection": 0.5}, {"blur": 1.0}, {"noise": 8.0},
        {"sharpening": 1.0}, {"codec": "jpeg", "quality": 30}, {"codec": "video", "quality": 30},
        {"flicker": (0.9, 1.1, 1.0, 1.0)}, {"noise": 8.0, "noise_cell": 2}, {"offset": 0.1},
    ],
)  # fmt: skip
def test_every_effect_of_a_sensor_shows_and_is_repeated_exactly(effect):
    painted = paint_planar_scene(draw_planar_scene(np.random.default_rng(3), prompted=False))
    sensor = Sensor(**effect)
    one, other = (through_sensor(painted.frames, sensor) for _ in range(2))
    assert one.dtype == np.uint8
    np.testing.assert_array_equal(one, other)
    assert (one != painted.frames).any()


def test_what_is_not_known_costs_nothing():
    torch.manual_seed(0)
    window = planar_window(np.random.default_rng(1), HORIZON, prompted=False)
    batch = collate([window])
    centres, ground, constants = batch["scene_targets"]
    seen = centres[:, :, :4, :2]
    perceived = PerceptionOutput(
        (seen, seen, seen), torch.randn(1, 3, 32, 32), torch.randn(1, 2),
        torch.cat([seen[:, :, 3], torch.randn(1, 1, 1)], dim=-1),
        torch.cat([seen[:, :, 3] - seen[:, :, 2], torch.randn(1, 1, 1)], dim=-1),
        torch.randn(1, 1, 3), torch.randn(1, 1, 4),
    )  # fmt: skip
    tensors = [part.requires_grad_() for part in perceived[1:-1]]
    shake, radii = (part / 64 for part in batch["guidance"][1:])
    still = torch.zeros_like(shake)
    loss = PerceptionLoss()(perceived, (centres, ground, constants), still, radii)
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0, abs=1e-4)
    for tensor in tensors:
        assert tensor.grad is None or torch.isfinite(tensor.grad).all()
    unknown = perceived.centres.grad
    assert unknown is not None
    assert float(unknown[..., 2].abs().max()) == 0
    off = perceived._replace(seen_positions=(seen, seen, seen + 0.1))
    cost = PerceptionLoss()(off, (centres, ground, constants), still, radii)
    assert float(cost.detach()) > 1


def test_appearances_are_drawn_anew_for_every_window():
    generator = np.random.default_rng(0)
    assert len({draw_appearance(generator) for _ in range(50)}) == 50
