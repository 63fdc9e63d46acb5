import itertools
import math

import numpy as np
import pybullet
import pytest
from PIL import Image

from rollcast.camera import camera_for
from rollcast.scene import SCENARIOS, Scene
from tests.rollcast.simulation.lab import at_rest_in_bowl
from tests.rollcast.simulation.pictures import centre_of, empty, owners, picture

LOW, HIGH = (0.1, 0.05, 0.3), (0.02, -0.06, 0.8)
"""Two balls that overlap in the image, one above the other."""


@pytest.fixture(scope="module")
def scenes(simulator) -> dict[str, Scene]:
    """One scene with three large balls of each scenario (tables draw smaller ones too)."""
    scenes = {name: simulator.sequence(name, 3, 1, 4).scene for name in SCENARIOS}
    return {name: scene.model_copy(update={"radius_m": 0.225}) for name, scene in scenes.items()}


def one_ball(**fields: object) -> Scene:
    update = {"scenario": "hemisphere", "textured": True, **fields}
    return at_rest_in_bowl(0.5).model_copy(update=update)


@pytest.mark.parametrize("size", [32, 128, 300])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_frames_are_square_rgb_bytes(simulator, scenario, size):
    sequence = simulator.sequence(scenario, 1, 1, 4)
    frames = sequence.render(size)
    assert frames.shape == (4, size, size, 3)
    assert frames.dtype == np.uint8
    assert frames.min() < 60
    assert frames.max() > 150
    assert not np.array_equal(frames[0], frames[3])


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize(("radius", "size"), [(0.225, 128), (0.04, 400)])
def test_a_balls_image_is_centred_where_the_camera_projects_it(scenes, scenario, radius, size):
    scene = scenes[scenario].model_copy(update={"radius_m": radius})
    camera = camera_for(scenario, size)
    generator = np.random.default_rng(5)
    for _ in range(4):
        # Well apart, and above any ground.
        angle = generator.uniform(0, 2 * math.pi)
        angles = angle + np.array([0, 2, 4]) * math.pi / 3
        places = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), np.full(3, 1.0)], axis=1)
        shown = owners(scene, places, size)
        # A lamp at the side leaves one side of the balls so dark that its rim is missed.
        tolerance = 0.3 if scenario == "heightfield" else 0.2
        for index, expected in enumerate(camera.project(places)):
            assert centre_of(shown == index) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("radius", [0.04, 0.225])
def test_a_balls_image_is_as_large_as_the_ball(radius):
    scene = one_ball(radius_m=radius, textured=False)
    place = np.array([[0.1, -0.2, 0.5]])
    changed = np.any(picture(scene, place, 512) != empty(scene, 512), axis=-1)
    # Pixels at the rim count whole, of which half is covered on average.
    shown_px = math.sqrt(np.sum(changed) / math.pi)
    assert 0 < shown_px - radius * 512 / 2.1 < 1


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_higher_ball_hides_the_lower_one(scenes, scenario):
    scene = scenes[scenario]
    camera = camera_for(scenario, 128)
    far = (0.8, 0.8, 1.0)
    column, row = camera.project(np.array(HIGH)).astype(int)
    red_above = owners(scene, np.array([HIGH, LOW, far]))
    green_above = owners(scene, np.array([LOW, HIGH, far]))
    assert red_above[row, column] == 0
    assert green_above[row, column] == 1
    # The higher one is seen whole, the lower one in part, whatever their colours.
    for higher, lower, shown in ((0, 1, red_above), (1, 0, green_above)):
        assert 0 < np.sum(shown == lower) < 0.8 * np.sum(shown == higher)


def test_several_balls_have_their_colors_and_a_highlight(scenes):
    scene = scenes["hemisphere"]
    places = np.array([[-0.5, 0, 0.5], [0, 0.5, 0.5], [0.5, -0.3, 0.5]])
    frame = picture(scene, places).astype(int)
    for index, (column, row) in enumerate(camera_for("hemisphere", 128).project(places)):
        middle = frame[int(row), int(column)]
        aside = frame[int(row), int(column) + 9]
        assert np.argmax(aside) == index
        # The lamp at the camera shines back from the middle of the ball, in white.
        assert np.all(middle - aside > 60) or middle[index] == 255


def test_a_plain_ball_is_white_and_a_textured_one_has_several_colors():
    place = np.array([[0.0, 0.0, 0.4]])
    white, textured = (
        picture(one_ball(textured=flag), place)[55:73, 55:73].reshape(-1, 3).astype(int)
        for flag in (False, True)
    )
    np.testing.assert_array_equal(white.max(axis=1), white.min(axis=1))
    assert white.min() > 150
    saturation = textured.max(axis=1) - textured.min(axis=1)
    assert np.median(saturation) > 60
    assert len({tuple(color // 32) for color in textured}) >= 4


def test_the_texture_is_fixed_to_the_ball():
    """Each octant of the ball's body shows a colour of its own, however the ball is turned."""
    scene = one_ball()
    place, radius_px = np.array([[0.0, 0.0, 0.4]]), 0.225 * 400 / 2.1
    pixels = np.arange(400) + 0.5 - 200
    x, y = np.meshgrid(pixels / radius_px, -pixels / radius_px)
    inside = np.hypot(x, y) < 0.95
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[inside]
    seen: dict[tuple[bool, ...], list[np.ndarray]] = {}
    for quaternion in np.random.default_rng(2).normal(size=(12, 4)):
        orientation = quaternion / np.linalg.norm(quaternion)
        body_to_world = np.reshape(pybullet.getMatrixFromQuaternion(orientation.tolist()), (3, 3))
        body = normals @ body_to_world
        frame = picture(scene, place, 400, orientation[None])[inside].astype(float)
        for signs in itertools.product((False, True), repeat=3):
            octant = np.all((body > 0) == signs, axis=1) & (np.abs(body).min(axis=1) > 0.1)
            seen.setdefault(signs, []).extend(frame[octant])
    colors = {signs: np.array(shown) for signs, shown in seen.items()}
    assert len(colors) == 8
    for shown in colors.values():
        assert len(shown) > 1000
        assert np.abs(shown - shown.mean(axis=0)).max() <= 2
    means = [shown.mean(axis=0) for shown in colors.values()]
    for one, other in itertools.combinations(means, 2):
        assert np.abs(one - other).max() > 20


def test_a_quarter_turn_of_the_ball_turns_its_picture():
    scene = one_ball()
    place = np.array([[0.0, 0.0, 0.4]])
    tilted = np.array([0.3, -0.2, 0.1, 0.9]) / np.linalg.norm([0.3, -0.2, 0.1, 0.9])
    half = math.sqrt(0.5)
    x, y, z, w = tilted
    turned = half * np.array([x - y, y + x, z + w, w - z])
    before = picture(scene, place, 128, tilted[None])[55:73, 55:73]
    after = picture(scene, place, 128, turned[None])[55:73, 55:73]
    assert not np.array_equal(before, after)
    assert np.abs(np.rot90(before).astype(int) - after).max() <= 1


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_sizes_agree_after_averaging(simulator, scenario):
    """Larger frames, averaged over areas, are the smaller ones but for the checkerboard's edges."""
    sequence = simulator.sequence(scenario, 1, 2, 4)
    large, middle, small = (sequence.render(size)[0] for size in (300, 128, 32))

    def averaged(frame: np.ndarray, size: int) -> np.ndarray:
        box = Image.Resampling.BOX
        return np.asarray(Image.fromarray(frame).resize((size, size), box), dtype=float)

    for finer, coarser, tolerance in ((large, middle, 3), (large, small, 7), (middle, small, 7)):
        difference = np.abs(averaged(finer, len(coarser)) - coarser)
        assert difference.mean() < tolerance
        assert np.quantile(difference, 0.95) < 30


def test_light_comes_from_where_the_scene_says(scenes):
    """On a heightfield what faces the lamp is brighter, and the shadow falls to the other side."""
    scene = scenes["heightfield"]
    for x, y in itertools.product((-1.2, 1.2), repeat=2):
        lit = scene.model_copy(update={"light_position_m": (x, y, 2.0)})
        place = np.array([[0.0, 0.0, 0.6]])
        ground, with_ball = empty(lit).astype(int), picture(lit, place).astype(int)
        around = np.hypot(*(np.indices((128, 128)) - 63.5)) > 0.225 * 128 / 2.5 + 1
        shadow = around & ((ground - with_ball).sum(axis=-1) > 60)
        assert shadow.sum() > 50
        away = centre_of(shadow) - 64
        assert away @ np.array([x, -y]) < -5


def test_beyond_the_rim_there_is_no_bowl():
    frame = empty(one_ball(axis_ratio=0.5, scenario="ellipsoid", rotation_rad=0.0))
    assert frame[64, 10].max() < 30
    assert frame[10, 64].max() > 30
    assert frame[0, 0].max() < 30
