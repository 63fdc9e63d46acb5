"""The map of the ground against closed forms and against where balls really are."""

import numpy as np
import pytest

from rollcast.camera import BOWL_HALF_WIDTH_M, camera_for
from rollcast.simulation import Simulator
from rollcast.simulation.rendering import Renderer
from rollcast.surfaces import surface_of
from tests.rollcast.simulation.lab import turned
from tests.training.conftest import SCENES
from training.data.rest_height_map import MAP_CELLS, resting_ground
from training.data.scene_cache import SceneCache, load_scene_cache
from training.data.shards import Recording, Source, load_recordings, simulate_split
from training.data.windows import Symmetry, WindowMaker


@pytest.fixture(scope="module")
def simulator():
    one = Simulator()
    yield one
    one.close()


def cell_centres_m(half_width_m: float) -> tuple[np.ndarray, np.ndarray]:
    along = ((np.arange(MAP_CELLS) + 0.5) * 2 / MAP_CELLS - 1) * half_width_m
    return np.meshgrid(along, -along)


def maker_of(recording: Recording) -> WindowMaker:
    camera = camera_for(recording.scene.scenario, 128)
    known = SceneCache(
        Renderer(recording.scene, camera).empty[None], resting_ground(recording.scene)[None]
    )
    return WindowMaker([recording], None, known, scene_targets=True)


@pytest.mark.parametrize("radius", [0.04, 0.225])
def test_in_a_hemisphere_centres_rest_on_a_smaller_sphere(simulator, radius):
    scene = simulator.sequence("hemisphere", 1, 1, 4, parameters={"radius_m": radius}).scene
    x, y = cell_centres_m(BOWL_HALF_WIDTH_M)
    inner = 1 - radius
    # Near the rim the sphere is too steep for a grid.
    inside = np.hypot(x, y) < 0.85 * inner
    x, y = x[inside], y[inside]
    ground = resting_ground(scene)[:, inside]
    height = 1 - np.sqrt(inner**2 - x**2 - y**2) - radius
    np.testing.assert_allclose(ground[2], height / BOWL_HALF_WIDTH_M, atol=2e-3)
    np.testing.assert_allclose(ground[0], -x / inner, atol=0.02)
    np.testing.assert_allclose(ground[1], y / inner, atol=0.02)


def test_no_ball_rests_in_the_corners_of_a_bowl(simulator):
    ground = resting_ground(simulator.sequence("ellipsoid", 1, 1, 4).scene)
    assert np.isnan(ground[:, 0, 0]).all()
    assert np.isfinite(ground[:, MAP_CELLS // 2, MAP_CELLS // 2]).all()


def test_on_a_heightfield_it_is_the_height_of_a_ball_let_down(simulator):
    scene = simulator.sequence("heightfield", 1, 4, 4).scene
    ground = resting_ground(scene)
    half_width = camera_for("heightfield", 128).half_width_m
    x, y = cell_centres_m(half_width)
    surface = surface_of(scene)
    for row, column in ((3, 5), (16, 16), (20, 9), (28, 27)):
        resting = surface.resting_height(x[row, column], y[row, column], scene.radius_m)
        expected = (resting - scene.radius_m) / half_width
        assert ground[2, row, column] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("scenario", ["ellipsoid", "heightfield"])
def test_its_symmetries_are_those_of_the_turned_scene(simulator, scenario):
    def window(scene):
        recording = Recording(scene, simulator.simulate(scene, 20))
        return maker_of(recording).window(0, 2, 8)

    scene = simulator.sequence(scenario, 1, 5, 4).scene
    made = Symmetry(1, mirror=False).apply(window(scene)).scene_targets
    expected = window(turned(scene)).scene_targets
    np.testing.assert_allclose(made.centres, expected.centres, atol=1e-4)
    np.testing.assert_allclose(made.ground, expected.ground, atol=1e-3)
    np.testing.assert_array_equal(made.scene_constants, expected.scene_constants)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarter_turns", range(4))
def test_balls_move_along_the_ground_in_every_view(simulator, quarter_turns, mirror):
    """Balls that roll have no velocity along the normal, however the window is turned."""
    scene = simulator.sequence("ellipsoid", 1, 7, 4).scene
    recording = Recording(scene, simulator.simulate(scene, 120))
    window = maker_of(recording).window(0, 60, 30, seen=False)
    scene_targets = Symmetry(quarter_turns, mirror).apply(window).scene_targets
    centres = scene_targets.centres[0]
    cells = np.clip((centres[:, :2] + 1) / 2 * MAP_CELLS, 0, MAP_CELLS - 1).astype(int)
    normal_xy = scene_targets.ground[:2, cells[:, 1], cells[:, 0]].T
    normal_z = np.sqrt(1 - np.sum(normal_xy**2, axis=-1))
    moved = (centres[2:] - centres[:-2]) / 2
    along_normal = np.sum(moved[:, :2] * normal_xy[1:-1], axis=-1) + moved[:, 2] * normal_z[1:-1]
    # Cells are 4 pixels wide, so their normals are a little off.
    assert np.abs(along_normal).mean() < 0.1 * np.linalg.norm(moved, axis=-1).mean()


def test_a_survey_is_kept_beside_its_shards(runs):
    shards = simulate_split(Source("hemisphere"), "validation", SCENES, workers=1)
    first = load_scene_cache(shards, workers=1)
    assert first.ground.shape == (SCENES, 3, MAP_CELLS, MAP_CELLS)
    kept = [shards[0].with_suffix(f".{name}.npy") for name in SceneCache._fields]
    before = [file.stat().st_mtime_ns for file in kept]
    for one, other in zip(load_scene_cache(shards, workers=1), first, strict=True):
        np.testing.assert_array_equal(one, other)
    assert [file.stat().st_mtime_ns for file in kept] == before


def test_frames_over_a_survey_are_those_without(runs):
    """Where nothing moves they are the same; edges and shadows may be off by a level."""
    shards = simulate_split(Source("hemisphere"), "validation", SCENES, workers=1)
    recordings = load_recordings(shards)
    cached = (
        WindowMaker(recordings, None, load_scene_cache(shards, workers=1)).window(3, 40, 2).frames
    )
    shaded = WindowMaker(recordings, None).window(3, 40, 2).frames
    difference = np.abs(cached.astype(int) - shaded)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.01
