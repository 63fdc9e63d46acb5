"""Detection of balls in frames of any size: whole frames first, then patches around candidates.

The networks are passed in as functions, so service and training share the detection. Places are
points of the letterboxed square (:mod:`rollcast.patches`), lengths its halves.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import ceil
from typing import Any, Self, cast

import numpy as np
from jaxtyping import Bool, Float, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import REFINER_OUTPUTS
from rollcast.patches import Letterbox, cut_patches, half_widths, letterboxed

PASSES = 2
"""Number of refinement passes; the patches of the second one are centred on the first result."""

LEAST_SCORE = 0.1
"""Minimum score of a candidate that is refined."""
LIKELY = 0.5
"""Minimum score of a detected ball."""

LEAST_MOVING = 0.25
"""Minimum product of the confidences of presence and of motion of a moving ball."""
LEAST_MOTION = 0.05
"""Minimum product of both confidences of a ball that may move."""
SURELY_MOVING = 0.5
"""Minimum product of both confidences above which tiles are not searched."""

MIN_DISPLACEMENT, DISPLACEMENT_ERROR = 0.3 / 64, 0.1 / 64
"""Minimum displacement of a moving ball over the observed frames, and its error, points of the
square."""

TILE_SHARE = 0.55
"""Side of the tiles for small balls, relative to the shorter side of the frames."""
LARGEST_RATIO = 4
"""Longer side of the frames over the side of a tile, at most: a strip would have hundreds."""
TILE_SCORE_FACTOR = 0.5
"""Factor of scores in tiles, where false alarms are more frequent than in whole frames."""

Arrays = Mapping[str, np.ndarray]
Detect = Callable[[UInt8[np.ndarray, "1 4 128 128 3"]], Arrays]
"""Detector: frames to ``places`` [1, C, K, 2], ``radii``, ``scores`` and ``moving`` [1, C],
``votes`` [1, 2 K + 3, G, G] (places, logarithm of the radius, score and moving of every cell),
``ground`` and ``scene``."""
Refine = Callable[[Float[np.ndarray, "balls 4 3 32 32"], Sequence[str]], Arrays]
"""Refiner: patches and names of outputs to ``offsets`` [M, K, 2], ``log_radius`` [M], ``visible``
[M, K] (logits), ``log_sigmas`` [M, 2] and ``features`` [M, F]."""


class _Rows:
    """Arrays whose first axis is that of the balls; a base of dataclasses."""

    def taken(self, index: np.ndarray) -> Self:
        """Return some of the balls."""
        return type(self)(*(values[index] for values in self._columns()))

    def joined(self, other: Self | None) -> Self:
        """Return these balls and others, if there are any."""
        if other is None:
            return self
        columns = zip(self._columns(), other._columns(), strict=True)
        return type(self)(*(np.concatenate(both) for both in columns))

    def _columns(self) -> list[np.ndarray]:
        return [getattr(self, field.name) for field in fields(cast("Any", self))]


@dataclass(frozen=True)
class Candidates(_Rows):
    """Candidates of the detector, in points of the square."""

    places: Float[np.ndarray, "balls 4 2"]
    """Centres in the observed frames."""
    radii: Float[np.ndarray, " balls"]
    scores: Float[np.ndarray, " balls"]
    """Confidence of presence, 0..1."""
    moving: Float[np.ndarray, " balls"]
    """Confidence of motion, 0..1."""


@dataclass(frozen=True)
class Balls(_Rows):
    """Balls that were detected or prompted."""

    places: Float[np.ndarray, "balls 4 2"]
    """Centres in the observed frames."""
    radii: Float[np.ndarray, " balls"]
    scores: Float[np.ndarray, " balls"]
    """Confidence of presence, 0..1."""
    moving: Float[np.ndarray, " balls"]
    """Confidence of motion, 0..1."""
    visible: Float[np.ndarray, "balls 4"]
    """Confidence of visibility in each frame, 0..1."""
    log_sigmas: Float[np.ndarray, "balls 2"]
    """Logarithms of the standard deviations of the last position and of the last displacement."""
    features: Float[np.ndarray, "balls features"]

    def __len__(self) -> int:
        """Count the balls."""
        return len(self.radii)


def find_balls(
    detect: Detect,
    refine: Refine,
    frames: UInt8[np.ndarray, "4 height width 3"],
    prompts: Float[np.ndarray, "balls 2"] | None = None,
    radii: Float[np.ndarray, " balls"] | None = None,
) -> tuple[Balls, Arrays]:
    """Return the detected balls, by descending score, and all outputs of the detector.

    ``square`` [4, 128, 128, 3] is the input of the detector.

    Parameters
    ----------
    prompts
        Points in the last frame that select the balls, which are returned in their order.
    radii
        Of the prompts, NaN where a radius is not known.
    """
    square = letterboxed(frames, NETWORK_FRAME_SIZE)
    said = {**detect(square[None]), "square": square}
    if prompts is None:
        scores = said["scores"][0]
        kept = scores > LEAST_SCORE
        kept[:1] = True
        found = Candidates(*(said[field.name][0][kept] for field in fields(Candidates)))
        balls = _refined(refine, frames, found)
        if not (balls.scores * balls.moving > SURELY_MOVING).any():
            balls = balls.joined(_small_balls(detect, refine, frames))
        return balls.taken(_distinct(balls.places[:, -1], balls.radii, balls.scores)), said
    voted = votes_at(said["votes"][0], prompts)
    known = voted["radii"] if radii is None else np.where(np.isnan(radii), voted["radii"], radii)
    places = voted["places"]
    # A click anywhere on a ball means its centre; a click far from all votes is kept.
    off = np.linalg.norm(places[:, -1] - prompts, axis=-1)
    stays = off > np.maximum(known, 3 / 64)
    places[stays, -1] = prompts[stays]
    found = Candidates(places, known, np.ones(len(known)), voted["moving"])
    return _refined(refine, frames, found), said


def _small_balls(
    detect: Detect, refine: Refine, frames: UInt8[np.ndarray, "4 height width 3"]
) -> Balls | None:
    """Detect moving balls in tiles, where they are larger than in the whole frames.

    Returns
    -------
    Balls or None
        None without such balls, or where tiles show no more than the whole frames.
    """
    side = round(TILE_SHARE * min(frames.shape[1:3]))
    if side < NETWORK_FRAME_SIZE:
        return None
    found = _detect_in_tiles(detect, frames, side)
    # Patches lower both confidences.
    found = found.taken(found.scores * found.moving > SURELY_MOVING)
    if not len(found.radii):
        return None
    balls = _refined(refine, frames, found)
    balls = balls.taken(balls.scores * balls.moving > SURELY_MOVING)
    return replace(balls, scores=TILE_SCORE_FACTOR * balls.scores)


def by_motion(balls: Balls) -> np.ndarray:
    """Return the indices of the balls, by descending confidence of presence times motion."""
    return np.argsort(-balls.scores * balls.moving, kind="stable")


def moving_balls(balls: Balls, most: int) -> np.ndarray:
    """Return the indices of 1 to ``most`` moving balls, by descending confidence."""
    order = by_motion(balls)
    sure = order[(balls.scores * balls.moving)[order] > LEAST_MOVING]
    return sure[:most] if len(sure) else order[:1]


def votes_at(
    votes: Float[np.ndarray, "layers cells cells"], points: Float[np.ndarray, "balls 2"]
) -> Arrays:
    """Return the votes of the detector at points, by bilinear interpolation between cells."""
    cells = votes.shape[-1]
    at = np.clip((points + 1) * (cells / 2) - 0.5, 0, cells - 1)
    low = np.minimum(at.astype(int), cells - 2)
    x, y = low.T
    (dx, dy) = (at - low).T
    said = (
        votes[:, y, x] * (1 - dx) * (1 - dy)
        + votes[:, y, x + 1] * dx * (1 - dy)
        + votes[:, y + 1, x] * (1 - dx) * dy
        + votes[:, y + 1, x + 1] * dx * dy
    ).T
    count = (said.shape[1] - 3) // 2
    return {
        "places": said[:, : 2 * count].reshape(-1, count, 2).copy(),
        "radii": np.exp(said[:, -3]),
        "moving": said[:, -1],
    }


def _refined(refine: Refine, frames: np.ndarray, found: Candidates) -> Balls:
    """Refine candidates in patches of the frames."""
    places, radii = found.places, found.radii
    for _ in range(PASSES - 1):
        widths = half_widths(radii)
        seen = refine(cut_patches(frames, places, widths), ("offsets", "log_radius"))
        places = places + widths[:, None, None] * seen["offsets"]
        radii = widths * np.exp(seen["log_radius"])
    widths = half_widths(radii)
    seen = refine(cut_patches(frames, places, widths), REFINER_OUTPUTS)
    places = places + widths[:, None, None] * seen["offsets"]
    radii = widths * np.exp(seen["log_radius"])
    visible = _sigmoid(seen["visible"])
    # Patches measure motion more exactly than the detector.
    displacement = np.linalg.norm(places - places[:, -1:], axis=-1).max(axis=-1)
    moving = found.moving * _sigmoid((displacement - MIN_DISPLACEMENT) / DISPLACEMENT_ERROR)
    return Balls(
        places, radii, found.scores * visible[:, -1], moving, visible,
        seen["log_sigmas"] + np.log(widths)[:, None], seen["features"],
    )  # fmt: skip


def _sigmoid(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(logits, -30, 30)))


def _distinct(
    last: Float[np.ndarray, "balls 2"],
    radii: Float[np.ndarray, " balls"],
    scores: Float[np.ndarray, " balls"],
) -> np.ndarray:
    """Return the indices of the balls by descending score, without duplicate detections."""
    kept: list[int] = []
    for one in np.argsort(-scores, kind="stable").tolist():
        away = [
            np.linalg.norm(last[one] - last[other]) > 0.7 * max(radii[one], radii[other])
            for other in kept
        ]
        if all(away):
            kept.append(one)
    return np.array(kept, dtype=np.intp)


@dataclass(frozen=True)
class Sightings(_Rows):
    """Moving and resting balls in four frames, in pixels of the frames."""

    paths: Float[np.ndarray, "balls 4 2"]
    radii: Float[np.ndarray, " balls"]
    scores: Float[np.ndarray, " balls"]
    """Confidence of presence, 0..1."""
    moving: Float[np.ndarray, " balls"]
    """Confidence of motion, 0..1."""
    visible: Float[np.ndarray, "balls 4"]
    """Confidence of visibility in each frame, 0..1; 1 for balls that were not refined."""
    refined: Bool[np.ndarray, " balls"]
    """Refinement in patches; other balls have the positions of the coarse detector."""


def sight_balls(
    detect: Detect,
    refine: Refine,
    frames: UInt8[np.ndarray, "4 height width 3"],
    least_score: float,
    *,
    refine_still: bool,
) -> Sightings:
    """Detect all balls of a rectangle in squares whose side is its shorter side.

    In such a square of a wide picture a ball is larger than in the whole picture.

    Parameters
    ----------
    least_score
        Minimum score of a candidate of the detector.
    refine_still
        Whether balls that hardly move are refined too.
    """
    side = min(frames.shape[1:3])
    found = _detect_in_tiles(detect, frames, side)
    found = found.taken(found.scores > least_score)
    box = Letterbox(*frames.shape[1:3])
    visible = np.ones(found.places.shape[:2], np.float32)
    closer = refine_still | (found.scores * found.moving > LEAST_MOTION)
    if closer.any():
        balls = _refined(refine, frames, found.taken(closer))
        for values, refined in (
            (found.places, balls.places), (found.radii, balls.radii),
            (found.scores, balls.scores), (found.moving, balls.moving), (visible, balls.visible),
        ):  # fmt: skip
            values[closer] = refined
    every = Sightings(
        box.pixels(found.places), found.radii * box.side / 2, found.scores, found.moving, visible,
        closer,
    )  # fmt: skip
    return every.taken(_distinct(every.paths[:, -1], every.radii, every.scores))


def _detect_in_tiles(
    detect: Detect, frames: UInt8[np.ndarray, "4 height width 3"], side: int
) -> Candidates:
    """Run the detector on overlapping tiles that cover the frames, at most ten.

    Tiles are squares, of strips as high as these and a quarter as long.
    """
    whole = Letterbox(*frames.shape[1:3])
    side = max(side, ceil(whole.side / LARGEST_RATIO))
    rows, columns = (_tile_starts(length, side) for length in frames.shape[1:3])
    corners = np.array([(x, y) for y in rows for x in columns])
    tiles = [frames[:, y : y + side, x : x + side] for x, y in corners]
    said = detect(np.stack([letterboxed(tile, NETWORK_FRAME_SIZE) for tile in tiles]))
    tile = Letterbox(*tiles[0].shape[1:3])
    pixels = tile.pixels(said["places"]) + corners[:, None, None]
    return Candidates(
        whole.points(pixels).reshape(-1, *pixels.shape[2:]),
        (said["radii"] * (tile.side / whole.side)).reshape(-1),
        said["scores"].reshape(-1),
        said["moving"].reshape(-1),
    )


def _tile_starts(length: int, side: int) -> list[int]:
    """Return the starts of the fewest tiles, overlapping by a tenth, that cover a length."""
    count = 1 if side >= length else ceil((length - side) / (0.9 * side)) + 1
    return np.linspace(0, max(length - side, 0), count).round().astype(int).tolist()
