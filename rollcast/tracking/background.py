# pyright: standard
"""Background of a clip without balls, and foreground masks."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from rollcast.errors import FootageError

BLUR = (3, 3)
DARKEST_SHADOW = 0.45
"""Of the light that falls beside it."""
LEAST_DIFFERENCE = 22.0
"""Of colours, from which something may stand in front; units of a colour channel (0 to 255)."""
NOISES = 6.0
"""The same in multiples of the picture's usual difference."""
MOST_IN_FRONT = 0.25
"""Share of a picture that may keep changing; with more the camera moves, or the light."""
CHANGING = 0.1
"""Share of the pictures that differ from the median where something comes and goes."""
BAND_VALUES = 4_000_000
"""Values of all pictures that are compared at once; memory grows with them."""
BORDER = 3
"""Pixels on both sides of an outline, along which contrast is measured."""
CLEARER = 2.5
"""Times as clear an outline as another picture's, for a ball to be in the background."""
ROUND = 0.72
"""Share of the smallest circle around it that something round fills."""
LEAST_AREA = 20
"""Mask of a possible ball that rested for a long time."""


@dataclass(frozen=True)
class Background:
    """A set-up without balls, as a camera sees it.

    Attributes
    ----------
    picture
        RGB, a little blurred.
    threshold
        Difference from which something stands in front.
    """

    picture: Float32[np.ndarray, "height width 3"]
    threshold: float

    def in_front(
        self, picture: UInt8[np.ndarray, "height width 3"]
    ) -> Float32[np.ndarray, "height width"]:
        """Return how surely something stands in front, 0 to 1; shadows do not count."""
        difference = _difference(_even(picture, self.picture), self.picture)
        return np.clip(difference / self.threshold - 0.5, 0, 1)


def background_of(pictures: UInt8[np.ndarray, "pictures height width 3"]) -> Background:
    """Find the background of pictures from all over a clip.

    The background of a pixel is its most frequent colour. One
    that rested for most of the clip is taken out with the help of a picture that shows the place
    without it.

    Raises
    ------
    FootageError
        When too much of the pictures changes: the camera moves.
    """
    usual = cv2.blur(_usual(pictures), BLUR)
    # One picture at a time, twice: evened ones take four times the memory.
    noises = [np.median(_difference(_even(picture, usual), usual)) for picture in pictures]
    background = Background(usual, max(LEAST_DIFFERENCE, NOISES * float(np.median(noises))))
    emptied = usual.copy()
    for picture in pictures:
        seen = _even(picture, usual)
        # A place that a ball's shadow left is lighter; that is not the ball's outline.
        mask = _difference(seen, usual, 1 / DARKEST_SHADOW) > background.threshold
        _take_out(emptied, seen, mask)
    return Background(emptied, background.threshold)


def _usual(
    pictures: UInt8[np.ndarray, "pictures height width 3"],
) -> Float32[np.ndarray, "height width 3"]:
    """Return the colour that each pixel has most often: the median where little changes."""
    usual = np.empty(pictures.shape[1:], np.float32)
    unlike = np.zeros(pictures.shape[1:3], np.int64)
    band = max(1, BAND_VALUES // pictures[:, 0].size)
    for first in range(0, len(usual), band):
        rows = slice(first, first + band)
        usual[rows] = np.median(pictures[:, rows], axis=0)
        for one in pictures[:, rows]:
            unlike[rows] += np.abs(one - usual[rows]).max(axis=-1) > LEAST_DIFFERENCE
    lively = unlike / len(pictures) > CHANGING
    if lively.mean() > MOST_IN_FRONT:
        raise FootageError(
            f"{lively.mean():.0%} of the picture keep changing; tracking needs a fixed camera, "
            "even light and space around the balls"
        )
    rows, columns = np.nonzero(lively)
    few = max(1, BAND_VALUES // (3 * len(pictures)))
    for first in range(0, len(rows), few):
        place = rows[first : first + few], columns[first : first + few]
        usual[place] = _most_alike(pictures[:, *place].astype(np.float32), usual[place])
    return usual


def _most_alike(
    colours: Float32[np.ndarray, "pictures pixels 3"], usual: Float32[np.ndarray, "pixels 3"]
) -> Float32[np.ndarray, "pixels 3"]:
    """Return the colour of each pixel with the most like it, other ones being equally unlike."""
    least = np.full(len(usual), np.inf, np.float32)
    for picture in colours:
        apart = np.abs(colours - picture).max(axis=-1).clip(max=LEAST_DIFFERENCE).sum(axis=0)
        better = apart < least
        least[better] = apart[better]
        usual = np.where(better[:, None], picture, usual)
    return usual


def _even(
    picture: UInt8[np.ndarray, "height width 3"], background: Float32[np.ndarray, "height width 3"]
) -> Float32[np.ndarray, "height width 3"]:
    """Blur a picture and undo a flicker of its light."""
    seen = cv2.blur(picture.astype(np.float32), BLUR)
    few = (slice(None, None, 8), slice(None, None, 8))
    gain = np.median((seen[few] + 1) / (background[few] + 1), axis=(0, 1))
    return seen / gain.astype(np.float32)


def _difference(
    seen: Float32[np.ndarray, "height width 3"],
    background: Float32[np.ndarray, "height width 3"],
    brightest: float = 1.0,
) -> Float32[np.ndarray, "height width"]:
    """Distance of colours from the background's in any light from a shadow's to the brightest."""
    light = _dot(seen, background) / _dot(background, background).clip(1)
    unlike = seen - background * light.clip(DARKEST_SHADOW, brightest)[..., None]
    return np.sqrt(_dot(unlike, unlike))


def _dot(
    one: Float32[np.ndarray, "height width 3"], other: Float32[np.ndarray, "height width 3"]
) -> Float32[np.ndarray, "height width"]:
    # Several times as fast as a sum over the short last axis.
    return np.einsum("yxc,yxc->yx", one, other)


def _take_out(
    emptied: Float32[np.ndarray, "height width 3"],
    seen: Float32[np.ndarray, "height width 3"],
    mask: Bool[np.ndarray, "height width"],
) -> None:
    """Replace round regions that are outlined more clearly in the background than in a picture."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    around = np.ones((2 * BORDER + 1, 2 * BORDER + 1), np.uint8)
    for label in range(1, count):
        left, top, width, height, area = stats[label]
        if area < LEAST_AREA:
            continue
        margin = 2 * BORDER
        box = (
            slice(max(0, top - margin), top + height + margin),
            slice(max(0, left - margin), left + width + margin),
        )
        inside = (labels[box] == label).astype(np.uint8)
        if not is_round(inside):
            continue
        wide = cv2.dilate(inside, around) > 0
        outline = wide & (cv2.erode(inside, around) == 0)
        if _edge(emptied[box], outline) > CLEARER * _edge(seen[box], outline):
            emptied[box][wide] = seen[box][wide]


def is_round(shape: UInt8[np.ndarray, "height width"]) -> bool:
    """Return whether a region fills most of its smallest enclosing circle."""
    outlines, _ = cv2.findContours(shape, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    _, around = cv2.minEnclosingCircle(np.concatenate(outlines))
    # Outlines go through the middle of the outermost pixels.
    return bool(np.count_nonzero(shape) > ROUND * np.pi * (around + 0.5) ** 2)


def _edge(
    picture: Float32[np.ndarray, "height width 3"], outline: Bool[np.ndarray, "height width"]
) -> float:
    """Return how strongly colours change along most of an outline."""
    slopes = [cv2.Sobel(picture, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1))]
    return float(np.median(np.hypot(*slopes).max(axis=2)[outline]))
