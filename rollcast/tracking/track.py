# pyright: standard
"""Tracking of balls in a video."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from rollcast.clip import open_clip
from rollcast.errors import FootageError
from rollcast.footage import FrameSource, SquareCrop, TakenFrame
from rollcast.repeated_frames import NumberedFrame, distinct_frames
from rollcast.scene import MAX_BALLS
from rollcast.tracking.association import Identities, assign_identities, balls_in, palette_evidence
from rollcast.tracking.colors import as_hex, hue
from rollcast.tracking.finder import Detections, Finder, seen_frames
from rollcast.tracking.quality import NEAR, CloseApproach, Quality, quality_of, runs
from rollcast.tracking.smoothing import smoothed
from rollcast.tracking.tracklets import Tracklet, link_tracklets, moving_tracklets
from rollcast.tracking.tracks import Tracks

FEWEST_FRAMES = 20
MOST_CHANGING = 0.1
"""Share of the picture that may change from frame to frame; with more the camera moves."""
MERGED = 5
"""Frames between encounters of the same balls that count as one."""

Palettes = Float[np.ndarray, "balls colors"]


class Tracked(NamedTuple):
    """Properties of a clip."""

    tracks: Tracks
    quality: Quality
    palettes: Palettes
    """Shares of each ball's pixels by colour, for the next clip of the same set-up."""


def track(
    path: Path | FrameSource,
    finder: Finder,
    *,
    balls: int | None = None,
    crop: SquareCrop | None = None,
    like: Palettes | None = None,
    name: str | None = None,
) -> Tracked:
    """Track the balls of a clip, which is read once, in memory that does not grow with pictures.

    Parameters
    ----------
    path
        A clip (``rollcast.clip.open_clip``), or its path.
    finder
        Perception of a model.
    balls
        Number of balls; None counts the moving balls.
    crop
        Square of the picture that contains all balls at all times; None searches everywhere.
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
    rollcast.errors.ClientError
        When a service that finds the balls fails.
    """
    source = path if not isinstance(path, Path) else open_clip(path)
    reader = _ClipReader(source, crop)
    tracklets = link_tracklets(reader.detections(finder))
    frames = len(reader.times_s)
    if frames < FEWEST_FRAMES:
        raise FootageError(
            f"{source.name} has {frames} different frames, expected at least {FEWEST_FRAMES} to "
            "track balls in"
        )
    if (changing := float(np.median(reader.changes))) > MOST_CHANGING:
        raise FootageError(
            f"{source.name}: {changing:.0%} of the picture change from frame to frame; tracking "
            "needs a fixed camera and even light"
        )
    moving = moving_tracklets(tracklets)
    if not moving:
        raise FootageError(
            f"{source.name}: {len(tracklets)} round objects were found in {frames} frames, and "
            "none of them moves"
        )
    count = min(balls or balls_in(moving, frames, MAX_BALLS), len(moving))
    known = _ordered(assign_identities(moving, frames, count), like)
    owners = _owners(moving, known, frames, count)
    tracks = _tracks(name or Path(source.name).stem, reader, moving, owners, known)
    approaches = list(_close_approaches(tracks, moving, owners, known.palettes))
    return Tracked(tracks, quality_of(tracks, approaches, reader.repeated), known.palettes)


class _ClipReader:
    """Single pass over a clip, with the data that later steps need."""

    def __init__(self, source: FrameSource, crop: SquareCrop | None) -> None:
        self._source = source
        self._crop = crop
        self.size = (0, 0)
        self.corner = (0, 0) if crop is None else (crop.x, crop.y)
        self.numbers: list[int] = []
        self.times_s: list[float] = []
        self.changes: list[float] = []
        self.repeated = 0

    def detections(self, finder: Finder) -> Iterator[Detections]:
        """Yield the balls of each frame."""
        for seen in seen_frames(self._frames(), finder):
            self.numbers.append(seen.number)
            self.times_s.append(seen.time_s)
            yield seen.detections
        self.repeated = self._read - len(self.numbers)

    def _frames(self) -> Iterator[NumberedFrame]:
        self._read = 0

        def counted() -> Iterator[TakenFrame]:
            for taken in self._source.frames():
                self._read += 1
                yield taken

        for frame in distinct_frames(counted()):
            height, width = frame.picture.shape[:2]
            self.size = (width, height)
            self.changes.append(frame.changed)
            if self._crop is None:
                yield frame
            else:
                yield frame._replace(picture=self._crop.cut(frame.picture))


def _ordered(found: Identities, like: Palettes | None) -> Identities:
    """Put balls into the order of another clip's, or of their hues."""
    if like is None:
        order = np.argsort([hue(palette) for palette in found.palettes])
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


def _owners(
    tracklets: Sequence[Tracklet], known: Identities, frames: int, balls: int
) -> np.ndarray:
    """Index of each ball's tracklet in each frame, [frames, balls]; -1 in gaps."""
    owners = np.full((frames, balls), -1)
    for index, (tracklet, ball) in enumerate(zip(tracklets, known.balls, strict=True)):
        if ball >= 0:
            owners[tracklet.first : tracklet.last + 1, ball] = index
    return owners


def _tracks(
    name: str,
    reader: _ClipReader,
    tracklets: Sequence[Tracklet],
    owners: np.ndarray,
    known: Identities,
) -> Tracks:
    shape = owners.shape
    times_s = np.array(reader.times_s)
    positions, radii = np.full((*shape, 2), np.nan), np.full(shape, np.nan)
    confidences = np.zeros(shape)
    for ball in range(shape[1]):
        own = [tracklets[index] for index in np.unique(owners[:, ball]) if index >= 0]
        if not own:
            raise FootageError(
                f"{name}: ball {ball + 1} of {shape[1]} was not found in any frame; set the "
                "number of balls with --balls"
            )
        seen = np.flatnonzero(owners[:, ball] >= 0)
        own.sort(key=lambda one: one.first)
        measured = np.concatenate([one.positions_px for one in own])
        positions[seen, ball] = smoothed(times_s[seen], measured) + reader.corner
        radii[seen, ball] = np.median(np.concatenate([one.radii_px for one in own]))
        confidences[seen, ball] = np.clip(np.concatenate([one.scores for one in own]), 0, 1)
    colors = tuple(as_hex(palette) for palette in known.palettes)
    frames = np.array(reader.numbers)
    return Tracks(name, *reader.size, colors, frames, times_s, positions, radii, confidences)


def _close_approaches(
    tracks: Tracks, tracklets: Sequence[Tracklet], owners: np.ndarray, palettes: Palettes
) -> Iterable[CloseApproach]:
    """Yield the times at which two balls were close, and their colour evidence afterwards."""
    means = np.stack([tracklet.mean_colors for tracklet in tracklets])
    evidence = palette_evidence(means, palettes)
    for one, other in combinations(range(tracks.balls), 2):
        apart = np.linalg.norm(tracks.positions_px[:, one] - tracks.positions_px[:, other], axis=-1)
        near = NEAR * float(np.nanmedian(tracks.radii_px[:, [one, other]]))
        together = _merged(runs(apart < near))
        ends = [first for first, _ in together[1:]] + [len(owners)]
        for (first, last), end in zip(together, ends, strict=False):
            after = owners[last + 1 : end, [one, other]]
            after = after[(after >= 0).all(axis=1)]
            if not len(after):
                continue
            mine, theirs = evidence[after[:, 0]], evidence[after[:, 1]]
            kept = mine[:, one] + theirs[:, other]
            swapped = mine[:, other] + theirs[:, one]
            says = round(float((kept - swapped).sum()), 2)
            yield CloseApproach(balls=(one, other), first=first, last=last, evidence=says)


def _merged(times: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    merged: list[tuple[int, int]] = []
    for first, last in times:
        if merged and first - merged[-1][1] <= MERGED:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    return merged
