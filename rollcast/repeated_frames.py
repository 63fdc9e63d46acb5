"""Frames that a camera or a converter repeats: found, and left out.

A file with more frames a second than the camera took repeats some of them. Between a frame and its
repetition everything stands still, which no tracker can tell from balls that rest.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Int16, UInt8
from PIL import Image

from rollcast.footage import TakenFrame

COMPARED_PX = 256
"""Longer side of the grey pictures that are compared, about."""
LARGEST_CHANGE = 20
"""Maximum change of a grey value (0 to 255) by compression."""
MEAN_CHANGE = 0.1
"""Maximum mean change of grey values; the noise of a sensor exceeds it even without motion."""
LONGEST_S = 0.25
"""Time without a new frame after which the scene stands still, and nothing is repeated."""


class NumberedFrame(NamedTuple):
    """A picture of a clip."""

    number: int
    """Number of the frame from 0, repeated frames included."""
    time_s: float
    picture: UInt8[np.ndarray, "height width 3"]
    changed: float = 0.0
    """Share of the picture that differs from the last new frame."""


def distinct_frames(taken: Iterable[TakenFrame]) -> Iterator[NumberedFrame]:
    """Yield the frames of a clip without repetitions of the previous frame.

    A frame is compared with the last one that was yielded, so slow motion adds up until it shows.
    Of a scene that stands still for longer than LONGEST_S all frames are yielded.
    """
    last: tuple[Int16[np.ndarray, "rows columns"], float] | None = None
    waiting: list[NumberedFrame] = []
    for number, one in enumerate(taken):
        frame = NumberedFrame(number, one.time_s, one.load())
        grey = _grey(frame.picture)
        change: np.ndarray = np.empty(0)
        if last is not None and last[0].shape == grey.shape:
            change = np.asarray(np.abs(last[0] - grey), np.int16)
            frame = frame._replace(changed=float(np.mean(change > LARGEST_CHANGE)))
        if last is not None and change.size and _is_none(change):
            if frame.time_s - last[1] < LONGEST_S:
                # Their pictures are that of the last one: one of them suffices.
                waiting.append(frame if not waiting else frame._replace(picture=waiting[0].picture))
                continue
            yield from waiting
        else:
            last = (grey, frame.time_s)
        waiting = []
        yield frame


def _grey(picture: UInt8[np.ndarray, "height width 3"]) -> Int16[np.ndarray, "rows columns"]:
    factor = max(1, max(picture.shape[:2]) // COMPARED_PX)
    return np.asarray(Image.fromarray(picture).reduce(factor).convert("L"), np.int16)


def _is_none(change: Int16[np.ndarray, "rows columns"]) -> bool:
    return int(change.max()) <= LARGEST_CHANGE and float(change.mean()) <= MEAN_CHANGE
