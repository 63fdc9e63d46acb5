"""Every distribution of the paper's section "Experimental Setup", before any scene is dropped."""

import math
from collections.abc import Mapping

import numpy as np
import pybullet
import pytest

from rollcast.errors import SceneParametersError
from rollcast.scene import Scenario, Scene
from rollcast.simulation.sampling import draw_scene, scene_generator
from rollcast.surfaces import surface_of


def draw(
    scenario: Scenario, objects: int, seed: int, fixed: Mapping[str, object] | None = None
) -> Scene:
    """Draw a scene that nothing rejects."""
    generator = scene_generator(scenario, objects, seed)
    return draw_scene(scenario, objects, seed, generator, fixed or {}, lambda _: True)


@pytest.fixture(scope="module")
def hemispheres() -> list[Scene]:
    return [draw("hemisphere", 1, seed) for seed in range(400)]


@pytest.fixture(scope="module")
def ellipsoids() -> list[Scene]:
    return [draw("ellipsoid", 1, seed) for seed in range(400)]


@pytest.fixture(scope="module")
def crowded() -> list[Scene]:
    return [draw("ellipsoid", 3, seed) for seed in range(130)]


@pytest.fixture(scope="module")
def heightfields() -> list[Scene]:
    return [draw("heightfield", 1, seed) for seed in range(250)]


def assert_uniform(values: list[float], low: float, high: float) -> None:
    """Kolmogorov-Smirnov at 0.1 %, within the bounds."""
    ordered = np.sort(np.asarray(values))
    assert low <= ordered[0]
    assert ordered[-1] <= high
    expected = (ordered - low) / (high - low)
    count = len(ordered)
    ahead = np.arange(1, count + 1) / count - expected
    behind = expected - np.arange(count) / count
    assert max(ahead.max(), behind.max()) < 1.95 / math.sqrt(count)


def assert_signs_are_fair(values: np.ndarray) -> None:
    """Both signs of both columns equally often, whatever the other's."""
    positive = values > 0
    for share in (positive.mean(axis=0), (positive[:, 0] == positive[:, 1]).mean()):
        np.testing.assert_allclose(share, 0.5, atol=2 / math.sqrt(len(values)))


def start_angles(scene: Scene, ball: int = 0) -> tuple[float, float]:
    """Polar and azimuthal angle of the point of the bowl on which a ball starts."""
    surface = surface_of(scene)
    (contact,) = surface.contacts(scene.positions_m[ball], scene.radius_m)
    x, y, z = contact.point
    c, s = math.cos(scene.rotation_rad), math.sin(scene.rotation_rad)
    azimuth = math.atan2(c * y - s * x, (c * x + s * y) / scene.axis_ratio)
    return math.acos(max(z - 1, -1)), azimuth


def horizontal_start(scene: Scene) -> np.ndarray:
    """The velocity (v_x, v_y, 0) whose projection on the surface the first ball starts with."""
    contact = surface_of(scene).contacts(scene.positions_m[0], scene.radius_m)[0]
    velocity, normal = np.array(scene.velocities_m_s[0]), np.array(contact.normal)
    assert velocity @ normal == pytest.approx(0, abs=1e-9)
    return velocity[:2] - velocity[2] / normal[2] * normal[:2]


def test_balls_start_on_the_bowl_at_uniform_angles(hemispheres, ellipsoids):
    for scenes in (hemispheres, ellipsoids):
        angles = np.array([start_angles(scene) for scene in scenes])
        assert_uniform(angles[:, 0], math.pi / 2 - 1e-6, 9 * math.pi / 10 + 1e-6)
        assert_uniform(angles[:, 1], -math.pi, math.pi)
        for scene in scenes:
            (contact,) = surface_of(scene).contacts(scene.positions_m[0], scene.radius_m)
            assert math.dist(contact.point, scene.positions_m[0]) == pytest.approx(0.225)


def test_bowls_turn_and_stretch_uniformly(hemispheres, ellipsoids):
    assert {scene.axis_ratio for scene in hemispheres} == {1.0}
    assert_uniform([scene.axis_ratio for scene in ellipsoids], 0.5, 1)
    for scenes in (hemispheres, ellipsoids):
        assert_uniform([scene.rotation_rad for scene in scenes], -math.pi, math.pi)


def test_one_ball_in_a_bowl_starts_with_5_to_10_m_s_along_each_axis(hemispheres, ellipsoids):
    for scenes in (hemispheres, ellipsoids):
        # At the very rim the normal is level and the projection cannot be undone.
        inside = [scene for scene in scenes if start_angles(scene)[0] > 1.65]
        before = np.array([horizontal_start(scene) for scene in inside])
        assert_signs_are_fair(before)
        assert_uniform(np.abs(before[:, 0]), 5 - 1e-6, 10 + 1e-6)
        assert_uniform(np.abs(before[:, 1]), 5 - 1e-6, 10 + 1e-6)


def test_several_balls_in_a_bowl_start_with_10_to_15_m_s(crowded):
    speeds = [math.hypot(*velocity) for scene in crowded for velocity in scene.velocities_m_s]
    assert_uniform(speeds, 10 - 1e-9, 15 + 1e-9)
    for scene in crowded[:20]:
        for ball, velocity in enumerate(scene.velocities_m_s):
            (contact,) = surface_of(scene).contacts(scene.positions_m[ball], scene.radius_m)
            assert np.dot(velocity, contact.normal) == pytest.approx(0, abs=1e-9)
    angles = np.array([start_angles(scene, ball) for scene in crowded for ball in range(3)])
    assert_uniform(angles[:, 0], math.pi / 2 - 1e-6, 9 * math.pi / 10 + 1e-6)


def test_euler_angles_are_uniform(hemispheres, heightfields):
    """Three angles and their twins (x + pi, pi - y, z + pi) are one orientation: y is folded."""
    for scenes in (hemispheres, heightfields):
        angles = np.array(
            [pybullet.getEulerFromQuaternion(scene.orientations_xyzw[0]) for scene in scenes]
        )
        assert_uniform(angles[:, 0], -math.pi, math.pi)
        assert_uniform(angles[:, 1], -math.pi / 2, math.pi / 2)
        assert_uniform(angles[:, 2], -math.pi, math.pi)


def test_landscapes_are_turned_moved_and_scaled_uniformly(heightfields):
    assert_uniform([scene.noise_scale for scene in heightfields], 0.2, 0.7)
    assert_uniform([scene.rotation_rad for scene in heightfields], -math.pi, math.pi)
    # However turned, the visible square of 2.5 m stays within the plane of 8 m.
    farthest = 4 - 1.25 * math.sqrt(2)
    for axis in (0, 1):
        assert_uniform([s.noise_offset_m[axis] for s in heightfields], -farthest, farthest)


def test_the_light_stands_beyond_a_random_corner(heightfields):
    lights = np.array([scene.light_position_m for scene in heightfields])
    np.testing.assert_array_equal(lights[:, 2], 2)
    assert_signs_are_fair(lights[:, :2])
    assert_uniform(np.abs(lights[:, 0]), 1, 1.5)
    assert_uniform(np.abs(lights[:, 1]), 1, 1.5)


def test_balls_on_a_heightfield_start_anywhere_on_the_ground(heightfields):
    room = 1.25 - 0.225
    for axis in (0, 1):
        assert_uniform([scene.positions_m[0][axis] for scene in heightfields], -room, room)
    for scene in heightfields:
        nearest = surface_of(scene).contacts(scene.positions_m[0], scene.radius_m)[0]
        assert math.dist(nearest.point, scene.positions_m[0]) == pytest.approx(0.225, abs=1e-5)


def test_balls_on_a_heightfield_start_with_2_to_4_m_s_along_each_axis(heightfields):
    before = np.array([horizontal_start(scene) for scene in heightfields])
    assert_signs_are_fair(before)
    assert_uniform(np.abs(before[:, 0]), 2 - 1e-6, 4 + 1e-6)
    assert_uniform(np.abs(before[:, 1]), 2 - 1e-6, 4 + 1e-6)


@pytest.mark.parametrize(("objects", "textured"), [(1, True), (2, False), (3, False)])
@pytest.mark.parametrize("scenario", ["hemisphere", "heightfield"])
def test_one_ball_has_a_texture_and_several_have_colors(scenario, objects, textured):
    scene = draw(scenario, objects, 5)
    assert scene.objects == objects
    assert scene.textured == textured
    assert scene.radius_m == 0.225


FREE_OF_EACH_OTHER = [
    ("ellipsoid", {"textured": False}, set()),
    ("ellipsoid", {"radius_m": 0.04}, {"positions_m"}),
    ("ellipsoid", {"rotation_rad": 0.5}, {"positions_m", "velocities_m_s"}),
    ("ellipsoid", {"axis_ratio": 0.9}, {"positions_m", "velocities_m_s"}),
    ("ellipsoid", {"velocities_m_s": ((1, 2, 0),)}, set()),
    ("ellipsoid", {"orientations_xyzw": ((0, 0, 0, 1),)}, set()),
    ("heightfield", {"light_position_m": (1.0, 1.0, 2.0)}, set()),
    ("heightfield", {"noise_scale": 0.5}, {"positions_m", "velocities_m_s"}),
    ("heightfield", {"noise_offset_m": (0.1, 0.2)}, {"positions_m", "velocities_m_s"}),
    ("heightfield", {"positions_m": ((0, 0, 1.5),)}, set()),
]


@pytest.mark.parametrize(("scenario", "fixed", "follow"), FREE_OF_EACH_OTHER)
def test_a_fixed_parameter_leaves_the_other_draws_alone(scenario, fixed, follow):
    free, chosen = draw(scenario, 1, 3), draw(scenario, 1, 3, fixed)
    (name,) = fixed
    assert getattr(chosen, name) == fixed[name] != getattr(free, name)
    for other in Scene.model_fields.keys() - {name}:
        same = getattr(chosen, other) == getattr(free, other)
        assert same == (other not in follow), other


def test_where_a_ball_starts_is_drawn_alike_whatever_it_starts_on():
    """The ground's height and slope follow a fixed landscape; the draws do not."""
    free = draw("heightfield", 1, 3)
    chosen = draw("heightfield", 1, 3, {"noise_scale": 0.6, "rotation_rad": 0.1})
    assert chosen.positions_m[0][:2] == free.positions_m[0][:2]
    np.testing.assert_allclose(horizontal_start(chosen), horizontal_start(free), atol=1e-9)
    free, chosen = draw("ellipsoid", 1, 3), draw("ellipsoid", 1, 3, {"axis_ratio": 0.9})
    np.testing.assert_allclose(start_angles(chosen), start_angles(free), atol=1e-6)


def test_none_leaves_a_parameter_free():
    assert draw("ellipsoid", 1, 3, {"axis_ratio": None}) == draw("ellipsoid", 1, 3)


@pytest.mark.parametrize(
    ("fixed", "field", "expected"),
    [
        ({"gravity": 9.81}, "gravity", "one of the scene parameters scenario, seed"),
        ({"radius_m": 0.9}, "radius_m", "less than or equal to 0.25"),
        ({"axis_ratio": math.nan}, "axis_ratio", "finite number"),
        ({"rotation_rad": math.inf}, "rotation_rad", "finite number"),
        ({"positions_m": ((0, 0, math.inf),)}, "positions_m.0.2", "finite number"),
        ({"noise_scale": 0.5}, "scenario", "'hemisphere' has no noise_scale"),
        ({"scenario": "ellipsoid"}, "scenario", "'hemisphere' as in the call"),
        ({"seed": 4}, "seed", "3 as in the call"),
        ({"axis_ratio": 0.7}, "axis_ratio", "of a hemisphere is 1"),
        ({"velocities_m_s": ((0, 0, 0),) * 2}, "velocities_m_s", "2 entries for 1 balls"),
    ],
)
def test_parameters_that_do_not_fit_are_refused_by_name(fixed, field, expected):
    with pytest.raises(SceneParametersError, match=expected) as refusal:
        draw("hemisphere", 1, 3, fixed)
    assert refusal.value.field == field


def test_a_bowl_that_the_ball_would_wedge_in_is_refused_with_the_reason():
    with pytest.raises(SceneParametersError, match=r"at least 0\.452 for a ball of radius"):
        draw("ellipsoid", 1, 3, {"axis_ratio": 0.4})
    assert draw("ellipsoid", 1, 3, {"axis_ratio": 0.4, "radius_m": 0.15}).axis_ratio == 0.4
