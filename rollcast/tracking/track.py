# pyright: standard
"""Tracking of balls in a video."""

from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.optimize import linear_sum_assignment

from rollcast.clip import open_clip
from rollcast.errors import FootageError
from rollcast.footage import FrameSource, SquareCrop
from rollcast.tracking.association import Identities, assign_identities, balls_in, palette_evidence
from rollcast.tracking.background import background_of
from rollcast.tracking.detection import BIN_WIDTHS, BINS, Detections, Detector, radius_of_balls
from rollcast.tracking.quality import (
    NEAR,
    CloseApproach,
    Quality,
    TrackingEvidence,
    quality_of,
    runs,
)
from rollcast.tracking.smoothing import smoothed
from rollcast.tracking.tracklets import Tracklet, link_tracklets
from rollcast.tracking.tracks import Tracks

MOST_BALLS = 4
SAMPLES = 80
"""Pictures, from all over a clip, that its background is made of."""
SAMPLES_BYTES = 512 * 2**20
"""Memory that these pictures take at most; of larger ones there are fewer."""
FEWEST_FRAMES = 20
SURE_SCORE = 0.85
"""Of a detection that is nothing but a ball."""
TOUCHING = 4.0
"""Radii from where a ball was last, within which something large may have taken it."""
MERGED = 5
"""Frames between encounters of the same balls that count as one."""

Palettes = Float[np.ndarray, "balls colours"]


class Tracked(NamedTuple):
    """Properties of a clip."""

    tracks: Tracks
    quality: Quality
    palettes: Palettes
    """Shares of each ball's pixels by colour, for the next clip of the same set-up."""


def track(
    path: Path | FrameSource,
    *,
    balls: int | None = None,
    crop: SquareCrop | None = None,
    like: Palettes | None = None,
    name: str | None = None,
) -> Tracked:
    """Track the balls of a clip, in memory that does not grow with the pictures' number.

    Parameters
    ----------
    path
        A clip (``rollcast.clip.open_clip``), or its path.
    balls
        How many there are; None counts them.
    crop
        A square of the picture that all balls stay in; None looks everywhere.
    like
        Palettes of another clip of the same balls, whose order is kept; None orders them by hue.
    name
        Name of the clip; by default that of the file.

    Raises
    ------
    FootageError
        When the file cannot be read, is too short, its camera moves or no balls move in it.
    CropError
        When the crop does not lie inside the picture.
    """
    source = path if not isinstance(path, Path) else open_clip(path)
    times_s = np.array([taken.time_s for taken in source.frames()])
    if len(times_s) < FEWEST_FRAMES:
        raise FootageError(
            f"{source.name} has {len(times_s)} frames, expected at least {FEWEST_FRAMES} to track "
            "balls in"
        )
    height, width = next(source.frames()).load().shape[:2]
    detector = _detector(_samples(source, crop, len(times_s)))
    frames = [detector.detect(_cut(taken.load(), crop)) for taken in source.frames()]
    tracklets = link_tracklets(frames, detector.radius_px)
    if not 0 < len(tracklets) < len(frames):
        raise FootageError(
            f"{source.name}: {len(tracklets)} ball-like objects appear and disappear in "
            f"{len(frames)} "
            "frames, expected fewer than frames and at least one; exclude other moving objects "
            "with --crop"
        )
    count = balls or balls_in(tracklets, len(frames), MOST_BALLS)
    known = _ordered(assign_identities(tracklets, frames, count, detector.radius_px), like)
    rows = _rows(tracklets, known, len(frames), count)
    corner = (0, 0) if crop is None else (crop.x, crop.y)
    tracks = _tracks(
        name or Path(source.name).stem, (width, height), corner, times_s, frames, rows, known
    )
    evidence = TrackingEvidence(
        _touched(tracks, frames),
        list(_encounters(tracks, frames, rows, known.palettes)),
    )
    return Tracked(tracks, quality_of(tracks, evidence), known.palettes)


def _samples(
    source: FrameSource, crop: SquareCrop | None, frames: int
) -> UInt8[np.ndarray, "samples height width 3"]:
    """Return pictures from all over a clip, as many as SAMPLES_BYTES hold."""
    shape = _cut(next(source.frames()).load(), crop).shape
    count = min(SAMPLES, max(FEWEST_FRAMES, SAMPLES_BYTES // int(np.prod(shape))))
    chosen = sorted(set(np.linspace(0, frames - 1, count).astype(int).tolist()))
    samples = np.empty((len(chosen), *shape), np.uint8)
    place = {frame: index for index, frame in enumerate(chosen)}
    for frame, taken in enumerate(source.frames()):
        if frame in place:
            samples[place[frame]] = _cut(taken.load(), crop)
    return samples


def _detector(samples: UInt8[np.ndarray, "samples height width 3"]) -> Detector:
    background = background_of(samples)
    return Detector(background, radius_of_balls(background, samples))


def _cut(
    picture: UInt8[np.ndarray, "height width 3"], crop: SquareCrop | None
) -> UInt8[np.ndarray, "height width 3"]:
    return picture if crop is None else crop.cut(picture)


def _ordered(found: Identities, like: Palettes | None) -> Identities:
    """Put balls into the order of another clip's, or of their hues."""
    if like is None:
        order = np.argsort([_hue(palette) for palette in found.palettes])
    else:
        alike = np.minimum(like[:, None], found.palettes).sum(axis=-1)
        order = _best_order(alike)
    place = {int(ball): index for index, ball in enumerate(order)}
    return Identities(
        [place.get(ball, -1) for ball in found.balls], found.palettes[order], found.value
    )


def _best_order(alike: Float[np.ndarray, "known balls"]) -> np.ndarray:
    """Return the most similar ball for each known palette; other balls come last."""
    _, order = linear_sum_assignment(-alike)
    rest = [ball for ball in range(alike.shape[1]) if ball not in order]
    return np.array([*order, *rest], int)


def _mean_lab(palette: Float[np.ndarray, " colours"]) -> Float[np.ndarray, "3"]:
    centres = [(np.arange(n) + 0.5) * w for n, w in zip(BINS, BIN_WIDTHS, strict=True)]
    grid = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1).reshape(-1, 3)
    return palette @ grid


def _hue(palette: Float[np.ndarray, " colours"]) -> float:
    """Angle in the plane of CIE Lab's colour axes, from pink over red, yellow and green to blue."""
    _, a, b = _mean_lab(palette) - 128
    return float(np.arctan2(b, a) % (2 * np.pi))


def _rows(tracklets: Sequence[Tracklet], known: Identities, frames: int, balls: int) -> np.ndarray:
    """Index of each ball's detection in each frame, [frames, balls]; -1 in gaps."""
    rows = np.full((frames, balls), -1)
    for tracklet, ball in zip(tracklets, known.balls, strict=True):
        if ball >= 0:
            rows[tracklet.first : tracklet.last + 1, ball] = tracklet.rows
    return rows


def _tracks(
    name: str,
    size: tuple[int, int],
    corner: tuple[int, int],
    times_s: Float[np.ndarray, " frames"],
    frames: Sequence[Detections],
    rows: np.ndarray,
    known: Identities,
) -> Tracks:
    shape = rows.shape
    positions, radii = np.full((*shape, 2), np.nan), np.full(shape, np.nan)
    confidences = np.zeros(shape)
    for ball in range(shape[1]):
        seen = np.flatnonzero(rows[:, ball] >= 0)
        if not len(seen):
            raise FootageError(
                f"{name}: ball {ball + 1} of {shape[1]} was not found in any frame; set the "
                "number of balls with --balls"
            )
        found = [(frames[i], rows[i, ball]) for i in seen.tolist()]
        measured = np.stack([frame.positions_px[row] for frame, row in found])
        positions[seen, ball] = smoothed(times_s[seen], measured) + corner
        radii[seen, ball] = float(np.median([frame.radii_px[row] for frame, row in found]))
        scores = np.array([frame.scores[row] for frame, row in found])
        confidences[seen, ball] = np.clip(scores / SURE_SCORE, 0, 1)
    colours = tuple(_hex(palette) for palette in known.palettes)
    return Tracks(name, *size, colours, times_s, positions, radii, confidences)


def _touched(tracks: Tracks, frames: Sequence[Detections]) -> np.ndarray:
    """Return whether a large object covers the last position of a missing ball, [frames, balls]."""
    touched = np.zeros(tracks.found.shape, bool)
    last_px = tracks.positions_px[0]
    for index, found in enumerate(tracks.found):
        last_px = np.where(found[:, None], tracks.positions_px[index], last_px)
        near_px = TOUCHING * np.nanmedian(tracks.radii_px, axis=0)
        for place in frames[index].touched_px:
            apart = np.linalg.norm(last_px - place, axis=1)
            touched[index] |= ~found & (apart < near_px)
    return touched


def _hex(palette: Float[np.ndarray, " colours"]) -> str:
    lab = _mean_lab(palette).clip(0, 255).astype(np.uint8).reshape(1, 1, 3)
    red, green, blue = cv2.cvtColor(lab, cv2.COLOR_Lab2RGB)[0, 0]
    return f"#{red:02x}{green:02x}{blue:02x}"


def _encounters(
    tracks: Tracks, frames: Sequence[Detections], rows: np.ndarray, palettes: Palettes
) -> Iterable[CloseApproach]:
    """Yield the times at which two balls were close, and their colour evidence afterwards."""
    for one, other in combinations(range(tracks.balls), 2):
        apart = np.linalg.norm(tracks.positions_px[:, one] - tracks.positions_px[:, other], axis=-1)
        near = NEAR * float(np.nanmedian(tracks.radii_px[:, [one, other]]))
        together = _merged(runs(apart < near))
        ends = [first for first, _ in together[1:]] + [len(frames)]
        for (first, last), end in zip(together, ends, strict=False):
            after = [i for i in range(last + 1, end) if (rows[i, [one, other]] >= 0).all()]
            if not after:
                continue
            seen = [
                palette_evidence(
                    np.stack([frames[i].colours[rows[i, ball]] for i in after]), palettes
                )
                for ball in (one, other)
            ]
            kept = seen[0][:, one] + seen[1][:, other]
            swapped = seen[0][:, other] + seen[1][:, one]
            evidence = round(float((kept - swapped).sum()), 2)
            yield CloseApproach(balls=(one, other), first=first, last=last, evidence=evidence)


def _merged(times: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    merged: list[tuple[int, int]] = []
    for first, last in times:
        if merged and first - merged[-1][1] <= MERGED:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    return merged
