import numpy as np
import pytest

from rollcast.simulation.appearance import CameraPose, draw_camera
from tests.training.conftest import SCENES
from training.data.ball_batch import MOST_BALLS, collate
from training.data.ball_windows import (
    BallAppearanceMixture,
    BallSource,
    BallStream,
    BallWindowMaker,
    filmed,
    planar_window,
    posed,
    turned,
)
from training.data.painting.camera import unposed_points
from training.data.painting.restyled import visible_pose
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, load_recordings, simulate_split


@pytest.fixture(scope="module")
def maker(runs) -> BallWindowMaker:
    shards = simulate_split(Source("hemisphere"), "training", SCENES, 1)
    return BallWindowMaker(load_recordings(shards), load_scene_cache(shards, 1))


def test_planar_windows_tell_of_every_ball():
    windows = [planar_window(np.random.default_rng(seed)) for seed in range(30)]
    counts = {len(window.radii) for window in windows}
    assert len(counts) > 3
    assert max(counts) <= MOST_BALLS
    for window in windows:
        assert len(window.places) == len(window.visible) == len(window.moving)
        assert np.isfinite(window.places).all()
        assert ((window.visible >= 0) & (window.visible <= 1)).all()
        still = np.ptp(window.centres[:, :4, :2], axis=1).max(axis=1) == 0
        assert (window.moving[still] == 0).all()


def test_a_window_of_a_seed_is_the_same_again():
    one, other = (planar_window(np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.frames, other.frames)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_truth_follows_the_symmetry_of_the_picture(maker, turns, mirror):
    window = maker.at(0, 60)
    mean = window.frames[3].astype(float).mean(axis=-1)
    moved = turned(window, turns, mirror=mirror)
    x, y = (64 + 64 * window.places[0, 3]).astype(int)
    u, v = (64 + 64 * moved.places[0, 3]).astype(int)
    there = moved.frames[3].astype(float).mean(axis=-1)
    assert (
        abs(mean[y - 3 : y + 4, x - 3 : x + 4].mean() - there[v - 3 : v + 4, u - 3 : u + 4].mean())
        < 12
    )
    assert np.allclose(np.linalg.norm(moved.spins, axis=-1), np.linalg.norm(window.spins, axis=-1))


def test_four_quarter_turns_change_nothing(maker):
    window = maker.at(1, 30)
    again = window
    for _ in range(4):
        again = turned(again, 1, mirror=False)
    for one, other in zip(window, again, strict=True):
        assert np.allclose(one, other, equal_nan=True)


def test_another_sensor_shakes_places_and_leaves_the_way(maker):
    window = maker.at(2, 40)
    for seed in range(40):
        shown = filmed(np.random.default_rng(seed), window)
        assert np.array_equal(shown.centres, window.centres)
        assert np.allclose(shown.places[:, 3], window.places[:, 3])
        if not np.allclose(shown.places, window.places):
            return
    pytest.fail("no sensor shook the picture")


def test_a_camera_that_stands_nearer_sees_larger_balls(maker):
    window = maker.at(3, 50)
    radius_m = window.scene[1] / 5
    near = posed(window, CameraPose(scale=1.25), radius_m)
    assert np.allclose(near.radii, 1.25 * window.radii)
    assert np.allclose(near.places, 1.25 * window.places)
    assert near.scene[1] == pytest.approx(window.scene[1])
    # Radius in halves of the frame, from the scene's constants: scale and radius in metres.
    assert near.scene[1] / 5 / (near.scene[0] / 5 + 1.05) == pytest.approx(near.radii[0])


def test_batches_depend_on_their_number_alone(maker):
    def stream(first: int) -> BallStream:
        return BallStream([BallSource(maker, 1.0, 100)], BallAppearanceMixture(), 3, 7, first)

    whole = iter(stream(0))
    next(whole)
    second, again = next(whole), next(iter(stream(1)))
    assert np.array_equal(second.frames, again.frames)
    assert second.places.shape == (3, MOST_BALLS, 4, 2)
    assert ((second.there == 0) == second.radii.isnan()).all()


@pytest.mark.parametrize("kind", ["paper", "filmed", "restyled"])
@pytest.mark.parametrize("spacing", [0.4, 2.0])
def test_frames_of_another_spacing_show_the_same_balls_at_other_times(maker, kind, spacing):
    for seed in range(4):
        usual = maker.window(np.random.default_rng(seed), kind, 100, 1.0)
        other = maker.window(np.random.default_rng(seed), kind, 100, spacing)
        assert other.spacing == spacing
        assert np.allclose(other.places[:, 3], usual.places[:, 3], atol=1e-6)
        assert np.array_equal(other.centres, usual.centres, equal_nan=True)
        # Before the last frame the ball is as far back as it went in so many frames.
        if kind == "paper" and spacing == 2.0:
            assert np.allclose(other.places[:, 2], usual.places[:, 1], atol=1e-6)
        if kind == "paper":
            apart = np.abs(other.frames.astype(int) - usual.frames).mean(axis=(1, 2, 3))
            assert apart[3] < 0.01  # but for the rounding of orientations
            assert apart[0] > 0.05


def test_streams_draw_spacings(maker):
    source = [BallSource(maker, 1.0, 100)]
    mixture = BallAppearanceMixture(paper=1, filmed=0, restyled=0, planar=0, other_rates=0.5)
    batch = next(iter(BallStream(source, mixture, 40, 7, 0)))
    assert 8 < (batch.spacing != 1).sum() < 32
    assert batch.spacing.min() > 0.3
    assert batch.spacing.max() < 2.7


def test_collated_balls_are_padded(maker):
    batch = collate([maker.at(0, 10), planar_window(np.random.default_rng(1))])
    assert batch.there.sum(dim=1)[0] == 1
    assert batch.places[0, 1:].isnan().all()


@pytest.mark.parametrize("seed", range(6))
def test_a_camera_elsewhere_sees_nothing_beyond_the_frame_of_an_unbounded_ground(seed):
    pose = draw_camera(np.random.default_rng(seed))
    seen = visible_pose(pose, np.full((4, 2), 64.0), bounded=False)
    corners = np.array([(0, 0), (0, 128), (128, 0), (128, 128)], float)
    places = unposed_points(corners, seen)
    assert places.min() > -0.5
    assert places.max() < 128.5


def test_filmed_windows_know_the_scale_of_their_camera(maker):
    """The ball's radius in the picture is that of its metres at the scene's scale."""
    scales = set()
    for seed in range(30):
        window = maker.window(np.random.default_rng(seed), "filmed", 60)
        if np.isnan(window.scene).any():
            continue
        scales.add(round(float(window.scene[0]), 3))
        half_width_m = window.scene[0] / 5 + 1.05
        assert window.scene[1] / 5 / half_width_m == pytest.approx(window.radii[0])
    assert len(scales) > 5
