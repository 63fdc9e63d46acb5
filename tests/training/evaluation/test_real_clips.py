"""Windows of clips with tracks: where they begin, what is cut out, what counts as found."""

import json

import av
import numpy as np
import pytest

from training.evaluation.real_clips import FOUND_PX, clip_windows, find, perception_finder
from training.networks.perception import Perception

WIDTH, HEIGHT, FRAMES = 192, 160, 12
CROP = [32, 16, 128]


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """A white ball that goes right by three pixels a frame, and one that rests."""
    folder = tmp_path_factory.mktemp("clips")
    rows, columns = np.indices((HEIGHT, WIDTH)) + 0.5
    lines = ["clip,frame,time,ball,x,y,radius"]
    with av.open(str(folder / "ball.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"crf": "5"}
        for frame in range(FRAMES):
            x, y = 60.0 + 3 * frame, 80.0
            disc = np.hypot(columns - x, rows - y) < 6
            picture = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
            picture[disc] = 250
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            lines.append(f"ball.mp4,{frame},{frame / 25},white,{x},{y},6")
            lines.append(f"ball.mp4,{frame},{frame / 25},resting,100,30,6")
        container.mux(stream.encode())
    (folder / "one.csv").write_text("\n".join(lines))
    return folder


def test_windows_show_the_ball_where_the_table_says(clips):
    setup = {"file": "ball.mp4", "crop": CROP, "targets": ["white", "resting"]}
    windows = clip_windows(clips, clips, "one", setup)
    assert len(windows) == 5  # begun at frames 0, 2, 4, 6 and 8; what rests does not count
    for window in windows:
        assert window.radius == 6
        for frame, (x, y) in zip(window.frames, window.path, strict=True):
            assert frame[int(y), int(x)].min() > 200
            assert frame[int(y), int(x) + 12].max() < 80


def test_frames_that_a_camera_repeats_are_left_out(clips):
    kept = list(range(0, FRAMES, 2))
    (clips / "keep.json").write_text(json.dumps(kept))
    setup = {"file": "ball.mp4", "crop": CROP, "targets": ["white"], "keep": "keep.json"}
    windows = clip_windows(clips, clips, "one", setup)
    np.testing.assert_allclose(np.diff(windows[0].path[:, 0]), 6)


def test_a_prompt_begins_within_reach_of_the_ball(clips):
    setup = {"file": "ball.mp4", "crop": CROP, "targets": ["white"]}
    windows = clip_windows(clips, clips, "one", setup)
    # Untrained perception corrects nothing: it returns the prompt.
    made = find(perception_finder(Perception(1).eval()), windows, prompted=True)
    assert made.position_errors.max() < 6
    np.testing.assert_array_equal(made.found, made.position_errors <= max(6, FOUND_PX))
    np.testing.assert_allclose(made.displacement_errors, 3, atol=1e-4)


def test_of_several_answers_the_nearest_counts(clips):
    setup = {"file": "ball.mp4", "crop": CROP, "targets": ["white"]}
    windows = clip_windows(clips, clips, "one", setup)
    paths = {window.frames.tobytes(): window.path for window in windows}

    def finder(frames, prompt):
        assert prompt is None
        path = paths[frames.tobytes()] / 64 - 1
        far = np.full_like(path, 0.9)
        near = path + np.array([[0, 0], [0, 0], [1, 0], [0, 1]]) / 64
        return np.stack([far, near])

    made = find(finder, windows, prompted=False)
    np.testing.assert_allclose(made.position_errors, 1)
    np.testing.assert_allclose(made.displacement_errors, np.sqrt(2))
    assert made.found.all()
