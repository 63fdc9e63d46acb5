"""Which frames repeat the one before, on pictures that are made here."""

import numpy as np

from rollcast.footage import TakenFrame
from rollcast.repeated_frames import distinct_frames

RATE = 60


def numbers(places, noise=0.0):
    """Numbers of the frames that are kept of a square at some columns."""
    generator = np.random.default_rng(0)

    def picture(place):
        made = np.full((60, 200, 3), 90.0)
        made[20:32, int(place) : int(place) + 12] = 230
        return (made + generator.normal(0, noise, made.shape)).clip(0, 255).astype(np.uint8)

    taken = [
        TakenFrame(index / RATE, lambda place=place: picture(place))
        for index, place in enumerate(places)
    ]
    return [frame.number for frame in distinct_frames(taken)]


def test_every_frame_of_a_motion_is_kept():
    assert numbers(range(20)) == list(range(20))


def test_repeated_frames_are_left_out():
    assert numbers(np.repeat(range(6), 3)) == [0, 3, 6, 9, 12, 15]


def test_a_scene_that_stands_still_is_kept():
    assert numbers([5] * 40) == list(range(40))


def test_noise_tells_new_frames_of_a_scene_at_rest():
    assert numbers([5] * 40, noise=4) == list(range(40))
