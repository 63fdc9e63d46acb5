"""The finding with networks that are computed by hand: dots on black, told by their brightness."""

import numpy as np
import pytest

from rollcast.ball_finding import find_balls, moving_balls, sight_balls, votes_at
from rollcast.patches import Letterbox
from tests.rollcast import dot_balls
from tests.rollcast.dot_balls import CELLS, detect


def frames_of(
    paths: np.ndarray, height: int, width: int, spread: float | None = None
) -> np.ndarray:
    """Soft white dots [balls, 4, 2], pixels."""
    y, x = np.mgrid[:height, :width] + 0.5
    frames = np.zeros((4, height, width))
    spread = spread or max(height, width) / 64
    for path in paths:
        for frame, at in zip(frames, path, strict=True):
            frame += np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * spread**2))
    return np.repeat((255 * np.clip(frames, 0, 1)).astype(np.uint8)[..., None], 3, axis=-1)


def refine(patches: np.ndarray, wanted) -> dict[str, np.ndarray]:
    seen = dot_balls.refine(patches)
    return {name: seen[name] for name in wanted}


def test_balls_are_found_once_each_in_frames_of_any_rectangle():
    for height, width in ((128, 128), (240, 320), (300, 150)):
        paths = np.array([[[0.3, 0.4]] * 4, [[0.7, 0.6]] * 4]) * (width, height)
        paths = (
            paths + np.arange(4)[None, :, None] * np.array([1.0, 0.5]) * max(height, width) / 128
        )
        balls, _ = find_balls(detect, refine, frames_of(paths, height, width))
        sure = balls.taken(np.flatnonzero(balls.scores > 0.5))
        assert len(sure) == 2
        seen = Letterbox(height, width).pixels(sure.places)
        order = np.argsort(seen[:, 0, 0])
        assert np.abs(seen[order] - paths).max() < 0.6 * max(height, width) / 128


def test_balls_that_are_small_in_the_whole_frame_are_found_in_parts_of_it():
    """The detector sees a dot of 6 px in 600 x 600 at a fifth of its brightness."""
    path = np.array([431.0, 187.0]) + np.arange(4)[:, None] * np.array([9.0, -4.0])
    whole = frames_of(path[None], 600, 600, spread=3.3)
    balls, said = find_balls(detect, refine, whole)
    assert said["scores"].max() < 0.3
    first = balls.taken(moving_balls(balls, 1))
    assert np.abs(Letterbox(600, 600).pixels(first.places[0]) - path).max() < 2
    reduced = find_balls(detect, refine, whole[:, ::5, ::5])[0]
    assert (reduced.scores < 0.3).all()  # nothing more to see


@pytest.mark.parametrize(
    "size", [(32, 4096), (4096, 32), (240, 4096), (466, 1024), (720, 1280), (600, 600)]
)
def test_the_detector_runs_on_few_tiles_whatever_the_rectangle(size):
    """A strip has as many squares of its height as its client likes."""
    counted: list[int] = []

    def counting(frames: np.ndarray) -> dict[str, np.ndarray]:
        counted.append(len(frames))
        return detect(frames)

    blank = np.zeros((4, *size, 3), np.uint8)
    find_balls(counting, refine, blank)
    sight_balls(counting, refine, blank, 0.1, refine_still=False)
    assert max(counted) <= 10


@pytest.mark.parametrize("size", [(60, 900), (900, 60), (200, 900), (300, 300)])
def test_balls_of_strips_are_found_where_they_are(size):
    height, width = size
    start = np.array([0.8 * width, 0.5 * height] if width > height else [0.5 * width, 0.8 * height])
    path = start + np.arange(4)[:, None] * np.array([1.5, 1.0])
    frames = frames_of(path[None], height, width, spread=5)
    seen = sight_balls(detect, refine, frames, 0.3, refine_still=True)
    first = seen.taken(np.argsort(-seen.scores)[:1])
    assert np.abs(first.paths[0] - path).max() < 2


def test_a_ball_that_rests_does_not_move_whatever_the_detector_says():
    resting = np.array([[[40.0, 50]] * 4])
    rolling = np.array([[90.0, 80]]) + np.arange(4)[:, None] * np.array([0.6, 0.2])
    paths = np.concatenate([resting, rolling[None]])
    balls, _ = find_balls(detect, refine, frames_of(paths, 128, 128))
    at = 64 + 64 * balls.places[:, -1]
    (moved,) = at[balls.scores * balls.moving > 0.25]
    assert np.linalg.norm(moved - rolling[-1]) < 1


def test_prompts_name_the_balls_and_their_order():
    paths = np.array([[[30.0, 40]] * 4, [[90, 80]] * 4])
    prompts = (paths[::-1, -1] + 2 - 64) / 64
    balls, _ = find_balls(detect, refine, frames_of(paths, 128, 128), prompts)
    assert np.allclose(64 + 64 * balls.places[:, -1], paths[::-1, -1], atol=0.3)
    assert (balls.scores > 0.9).all()


def test_a_prompt_on_nothing_is_answered_with_a_low_score():
    paths = np.array([[[30.0, 40]] * 4])
    balls, _ = find_balls(detect, refine, frames_of(paths, 128, 128), np.array([[0.8, 0.8]]))
    assert len(balls) == 1
    assert balls.scores[0] < 0.1


def test_votes_between_cells_are_interpolated():
    votes = np.zeros((11, CELLS, CELLS))
    votes[0] = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1
    said = votes_at(votes, np.array([[0.21, -0.4], [5.0, 5.0]]))
    assert np.isclose(said["places"][0, 0, 0], 0.21)
    assert np.isclose(said["places"][1, 0, 0], 1 - 1 / CELLS)
