# pyright: standard
"""Round things of one size in front of a background, with their colours."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from rollcast.errors import FootageError
from rollcast.tracking.background import Background, is_round

SMALLEST_RADIUS_PX = 2.5
LARGEST_RADIUS = 0.12
"""Of the picture's shorter side."""
ALIKE = 0.12
"""Relative difference of radii that counts as none."""
LEAST_ROUND = 8
"""Round things in all pictures, from which their radius is known."""
RING = (1.15, 1.6)
"""Inner radius of the free ring around a ball, in ball radii."""
RING_WEIGHT = 0.5
"""What stands around counts against a ball, but not as much: it may touch another one."""
LEAST_SCORE = 0.5
APART = 1.3
"""Two balls' centres are farther apart, radii; touching ones are 2 apart, but one may be higher."""
COLOURED = 0.85
"""Part of the radius within which colours are a ball's own."""
BINS = (4, 16, 16)
"""Of lightness and of the two colour axes of CIE Lab."""
BIN_WIDTHS = (64, 16, 16)
COLOURS = BINS[0] * BINS[1] * BINS[2]
LARGE = 2.5
"""Areas of the balls found in it, from which a region is more than balls: a hand, a cue."""


@dataclass(frozen=True)
class Detections:
    """Candidates for balls in one picture."""

    positions_px: Float[np.ndarray, "found 2"]
    radii_px: Float[np.ndarray, " found"]
    scores: Float[np.ndarray, " found"]
    """1 for a full disc with nothing around it."""
    colours: Float32[np.ndarray, "found colours"]
    """Shares of a disc's pixels by colour (:func:`_colours`)."""
    touched_px: Float[np.ndarray, "others 2"]
    """Centres of ball-like parts of larger objects."""


class Detector:
    """Finds balls of about one radius.

    Parameters
    ----------
    radius_px
        Of all balls, about.
    """

    def __init__(self, background: Background, radius_px: float) -> None:
        self._background = background
        self.radius_px = radius_px
        self._kernel = _kernel(radius_px)

    def detect(self, picture: UInt8[np.ndarray, "height width 3"]) -> Detections:
        """Find the round things of a picture, the surest first."""
        front = self._background.in_front(picture)
        response = cv2.filter2D(front, cv2.CV_32F, self._kernel, borderType=cv2.BORDER_CONSTANT)
        peaks = _peaks(response, self.radius_px)
        positions, areas = _centred(front, peaks, self.radius_px)
        free = ~_touched(front, peaks, self.radius_px)
        lab = cv2.cvtColor(picture, cv2.COLOR_RGB2Lab)
        return Detections(
            positions[free],
            np.sqrt(areas[free] / np.pi),
            np.array([response[y, x] for x, y in peaks], np.float64)[free],
            np.array(
                [_colours(lab, position, self.radius_px) for position in positions[free]],
                np.float32,
            ).reshape(-1, COLOURS),
            positions[~free],
        )


def radius_of_balls(
    background: Background, pictures: UInt8[np.ndarray, "pictures height width 3"]
) -> float:
    """Return the typical radius of round objects in some pictures, pixels.

    Raises
    ------
    FootageError
        If no round object moves.
    """
    largest = LARGEST_RADIUS * min(background.picture.shape[:2])
    found: list[float] = []
    for picture in pictures:
        mask = (background.in_front(picture) > 0.5).astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        for label in range(1, count):
            left, top, width, height, area = stats[label]
            radius = float(np.sqrt(area / np.pi))
            box = (slice(top, top + height), slice(left, left + width))
            if SMALLEST_RADIUS_PX <= radius <= largest and is_round(
                (labels[box] == label).astype(np.uint8)
            ):
                found.append(radius)
    if len(found) < LEAST_ROUND:
        raise FootageError(
            f"{len(found)} round moving objects were found in {len(pictures)} pictures, expected "
            "at least "
            f"{LEAST_ROUND}: are there balls, of {SMALLEST_RADIUS_PX:g} to {largest:.0f} px in "
            "radius, that do not stay in one place?"
        )
    radii = np.array(found)
    # Specks are many and small, hands are large and of any size: balls are large and of one size.
    alike = np.abs(np.log(radii[:, None] / radii)) < ALIKE
    usual = radii[np.argmax((alike * radii**2).sum(axis=1))]
    return float(np.median(radii[np.abs(np.log(radii / usual)) < ALIKE]))


def _kernel(radius_px: float) -> Float32[np.ndarray, "side side"]:
    """Mean over a disc less a part of the mean over the ring around it."""
    half = int(np.ceil(RING[1] * radius_px))
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    distance = np.hypot(rows, columns) / radius_px
    disc = (distance <= 0.95).astype(np.float32)
    ring = ((distance >= RING[0]) & (distance <= RING[1])).astype(np.float32)
    return disc / disc.sum() - RING_WEIGHT * ring / ring.sum()


def _peaks(
    response: Float32[np.ndarray, "height width"], radius_px: float
) -> list[tuple[int, int]]:
    """Columns and rows of the largest responses, far enough apart, the largest first."""
    reach = max(1, int(0.6 * radius_px))
    highest = cv2.dilate(response, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    rows, columns = np.nonzero((response >= highest) & (response > LEAST_SCORE))
    kept: list[tuple[int, int]] = []
    for index in np.argsort(-response[rows, columns]):
        x, y = int(columns[index]), int(rows[index])
        if all(np.hypot(x - u, y - v) > APART * radius_px for u, v in kept):
            kept.append((x, y))
    return kept


def _centred(
    front: Float32[np.ndarray, "height width"], peaks: Sequence[tuple[int, int]], radius_px: float
) -> tuple[Float[np.ndarray, "found 2"], Float[np.ndarray, " found"]]:
    """Centres and areas of the foreground nearest to each peak."""
    centres = np.array(peaks, np.float64).reshape(-1, 2) + 0.5
    areas = np.zeros(len(peaks))
    for _ in range(3):
        moved = centres.copy()
        for index, centre in enumerate(centres):
            box, x, y = _patch(front.shape, centre, 1.25 * radius_px)
            own = np.hypot(x - centre[0], y - centre[1])
            weight = front[box] * (own <= 1.25 * radius_px)
            for other in np.delete(centres, index, axis=0):
                weight = weight * (own <= np.hypot(x - other[0], y - other[1]))
            areas[index] = weight.sum()
            if areas[index] > 0:
                moved[index] = (weight * x).sum() / areas[index], (weight * y).sum() / areas[index]
        centres = moved
    return centres, areas


def _patch(
    shape: tuple[int, ...], centre: Float[np.ndarray, "2"], reach_px: float
) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """Rows and columns around a place, and the pixels' centres there."""
    low = np.maximum(np.floor(centre - reach_px), 0).astype(int)
    high = np.minimum(np.ceil(centre + reach_px), [shape[1], shape[0]]).astype(int)
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
    return (slice(low[1], high[1]), slice(low[0], high[0])), x, y


def _colours(
    lab: UInt8[np.ndarray, "height width 3"], centre: Float[np.ndarray, "2"], radius_px: float
) -> Float32[np.ndarray, " colours"]:
    box, x, y = _patch(lab.shape, centre, radius_px)
    inside = np.hypot(x - centre[0], y - centre[1]) <= COLOURED * radius_px
    bins = lab[box][inside] // np.array(BIN_WIDTHS, np.uint8)
    numbers = np.ravel_multi_index(tuple(bins.T), BINS)
    counts = np.bincount(numbers, minlength=COLOURS).astype(np.float32)
    return counts / max(1.0, float(counts.sum()))


def _touched(
    front: Float32[np.ndarray, "height width"], peaks: Sequence[tuple[int, int]], radius_px: float
) -> np.ndarray:
    """Return whether each peak lies in a region that is larger than all its balls."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((front > 0.5).astype(np.uint8))
    regions = np.array([labels[y, x] for x, y in peaks], int)
    areas = stats[regions, cv2.CC_STAT_AREA] if len(peaks) else np.empty(0)
    balls = np.array([np.count_nonzero(regions == region) for region in regions])
    return (regions > 0) & (areas > LARGE * balls * np.pi * radius_px**2)
