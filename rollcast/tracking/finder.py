# pyright: standard
"""Balls in a clip's frames, found by the perception of a model, frame by frame.

Windows of four frames overlap by one. A few of them are asked for at once, so memory does not grow
with the clip.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from rollcast.ball_finding import Sightings
from rollcast.errors import FootageError
from rollcast.repeated_frames import NumberedFrame
from rollcast.tracking.colors import colors_at
from rollcast.trajectory import OBSERVED_FRAMES

SIDE_PX = 384
"""Shorter side of the pictures that are searched, the sample distance of patches."""
IN_FLIGHT = 3
"""Number of windows in one request."""
LEAST_SCORE = 0.25
"""Minimum score of a detection."""
SEEN = 0.5
"""Minimum confidence that a frame shows a ball."""


class Finder(Protocol):
    """Perception of balls in four pictures; called from several threads."""

    def prepare(self, picture: UInt8[np.ndarray, "height width 3"], /) -> Any:  # noqa: ANN401
        """Return a picture as :meth:`find` takes it."""
        ...

    def find(self, frames: list[Any], /) -> Sightings:
        """Find the balls of four prepared pictures, in pixels of these."""
        ...


@dataclass(frozen=True)
class Detections:
    """Balls, moving or not, in one frame."""

    positions_px: Float[np.ndarray, "found 2"]
    radii_px: Float[np.ndarray, " found"]
    scores: Float[np.ndarray, " found"]
    colors: Float32[np.ndarray, "found colors"]
    """Shares of a disc's pixels by colour (``colours.py``)."""


class SeenFrame(NamedTuple):
    """Frame of the clip and its detections."""

    number: int
    time_s: float
    detections: Detections


class _Small(NamedTuple):
    number: int
    time_s: float
    picture: np.ndarray
    prepared: Any
    scale: float
    """Pixels of the clip by pixel of the picture."""


def seen_frames(frames: Iterable[NumberedFrame], finder: Finder) -> Iterator[SeenFrame]:
    """Look at every frame of a clip.

    Raises
    ------
    FootageError
        When there are fewer than four frames.
    """
    flying: deque[tuple[list[_Small], int, Future[Sightings]]] = deque()
    with ThreadPoolExecutor(IN_FLIGHT) as pool:
        try:
            for window, known in _windows(frames, finder):
                asked = pool.submit(finder.find, [frame.prepared for frame in window])
                flying.append((window, known, asked))
                if len(flying) > IN_FLIGHT:
                    yield from _seen(*flying.popleft())
            while flying:
                yield from _seen(*flying.popleft())
        finally:
            for *_, asked in flying:
                asked.cancel()


def _windows(frames: Iterable[NumberedFrame], finder: Finder) -> Iterator[tuple[list[_Small], int]]:
    """Yield four frames at a time, and how many of them the window before had."""
    window: deque[_Small] = deque(maxlen=OBSERVED_FRAMES)
    new, wanted = 0, OBSERVED_FRAMES
    for frame in frames:
        window.append(_small(frame, finder))
        new += 1
        if new == wanted:
            yield list(window), OBSERVED_FRAMES - new
            new, wanted = 0, OBSERVED_FRAMES - 1
    if len(window) < OBSERVED_FRAMES:
        raise FootageError(f"{len(window)} different frames, expected at least {OBSERVED_FRAMES}")
    if new:
        yield list(window), OBSERVED_FRAMES - new


def _small(frame: NumberedFrame, finder: Finder) -> _Small:
    height, width = frame.picture.shape[:2]
    scale = max(1.0, min(height, width) / SIDE_PX)
    picture = frame.picture
    if scale > 1:
        size = (round(width / scale), round(height / scale))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    picture = np.ascontiguousarray(picture)
    return _Small(frame.number, frame.time_s, picture, finder.prepare(picture), scale)


def _seen(window: list[_Small], known: int, asked: Future[Sightings]) -> Iterator[SeenFrame]:
    found = asked.result()
    for index, frame in enumerate(window[known:], start=known):
        shown = found.visible[:, index] > SEEN
        positions, radii = found.paths[shown, index], found.radii[shown]
        colors = colors_at(frame.picture, positions, radii)
        detections = Detections(
            positions * frame.scale, radii * frame.scale, found.scores[shown], colors
        )
        yield SeenFrame(frame.number, frame.time_s, detections)
