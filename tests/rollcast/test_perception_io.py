import numpy as np

from rollcast.perception_io import FINALS, PLACES, run_perception


def brightness(wanted, seen):
    """Return the brightness of every frame, and that of the last one as the position."""
    level = seen["frames"][:, :, 0, 0, 0].astype(np.float32)
    said = {"all": level, PLACES: level[:, -1:]}
    return [said[name] for name in wanted]


def frames(*levels):
    rows = np.array(levels, np.uint8)[:, :, None, None, None]
    return np.broadcast_to(rows, (*rows.shape[:2], 128, 128, 3))


def test_the_observed_frames_are_read_as_they_are():
    seen = frames((1, 2, 3, 4), (5, 6, 7, 8))
    read = run_perception(brightness, ["all"], seen)
    assert read["all"].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


def test_a_final_frame_is_seen_as_four_of_balls_at_rest():
    calls = []

    def run(wanted, seen):
        calls.append(seen["frames"][:, :, 0, 0, 0].tolist())
        return brightness(wanted, seen)

    read = run_perception(run, ["all", FINALS], frames((1, 2, 3, 4, 9), (5, 6, 7, 8, 10)))
    assert calls == [[[1, 2, 3, 4], [5, 6, 7, 8], 4 * [9], 4 * [10]]]
    assert read["all"].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]
    assert read[FINALS].tolist() == [[9], [10]]
