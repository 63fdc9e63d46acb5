# pyright: standard
"""Tracklets: detections in consecutive frames that belong together without ambiguity."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from rollcast.tracking.colors import COLORS
from rollcast.tracking.finder import Detections

FARTHEST = 5.0
"""Radii from where a ball is expected, beyond which it is another one."""
COLOR_COST = 3.0
"""Cost of disjoint colours, as a distance in radii."""
CLEARER = 1.0
"""Minimum extra cost of the second-best pair; below it both tracklets end and are joined later."""
HISTORY = 4
"""Frames from which a velocity is known."""
MOVES = 1.5
"""Radii from its first place to its farthest, from which on a tracklet is of a ball that moves."""
CONTINUES = 1.5
"""Radii between the end of a tracklet and the beginning of another that may be of one ball."""
LONGEST_GAP = 30
"""Frames between such tracklets."""
FEWEST_FRAMES = 4
"""Minimum length of a tracklet; shorter ones count as false alarms."""


@dataclass
class Tracklet:
    """One detection in each of some frames that follow each other.

    Attributes
    ----------
    first
        Index of its first frame.
    positions_px
        Centres [frames][2].
    colors
        Sum of the colours of its detections.
    """

    first: int
    positions_px: list[Float[np.ndarray, "2"]] = field(default_factory=list[np.ndarray])
    radii_px: list[float] = field(default_factory=list[float])
    scores: list[float] = field(default_factory=list[float])
    colors: Float[np.ndarray, " colors"] = field(default_factory=lambda: np.zeros(COLORS))

    def __len__(self) -> int:
        """Return the number of its frames."""
        return len(self.positions_px)

    @property
    def last(self) -> int:
        """Index of its last frame."""
        return self.first + len(self) - 1

    @property
    def radius_px(self) -> float:
        """Median radius of its detections."""
        return float(np.median(self.radii_px))

    @property
    def mean_colors(self) -> Float[np.ndarray, " colors"]:
        """Mean colours of its detections."""
        return self.colors / len(self)

    @property
    def extent(self) -> float:
        """Distance of its farthest place from its first, radii."""
        places = np.stack(self.positions_px)
        return float(np.linalg.norm(places - places[0], axis=1).max()) / self.radius_px

    def velocity_px(self, *, at_end: bool) -> Float[np.ndarray, "2"]:
        """Displacement a frame near an end; 0 where there is but one frame."""
        few = self.positions_px[-HISTORY:] if at_end else self.positions_px[:HISTORY]
        if len(few) < 2:
            return np.zeros(2)
        # An impact makes the mean wrong for longer than it makes the last displacement.
        return np.median(np.diff(np.stack(few), axis=0), axis=0)

    def add(self, found: Detections, row: int) -> None:
        """Go on to a detection of the next frame."""
        self.positions_px.append(found.positions_px[row])
        self.radii_px.append(float(found.radii_px[row]))
        self.scores.append(float(found.scores[row]))
        self.colors = self.colors + found.colors[row]


def link_tracklets(frames: Iterable[Detections]) -> list[Tracklet]:
    """Join the detections of neighbouring frames where the match is unambiguous."""
    ended: list[Tracklet] = []
    going: list[Tracklet] = []
    before = np.empty((0, COLORS))
    for number, found in enumerate(frames):
        joined = _joined(going, before, found)
        ended += [
            tracklet
            for index, tracklet in enumerate(going)
            if index not in joined and len(tracklet) >= FEWEST_FRAMES
        ]
        rows = {row: going[index] for index, row in joined.items()}
        going = [rows.get(row) or Tracklet(number) for row in range(len(found.radii_px))]
        for row, tracklet in enumerate(going):
            tracklet.add(found, row)
        before = found.colors
    ended += [tracklet for tracklet in going if len(tracklet) >= FEWEST_FRAMES]
    return sorted(ended, key=lambda tracklet: tracklet.first)


def moving_tracklets(tracklets: Sequence[Tracklet]) -> list[Tracklet]:
    """Return the tracklets of balls that move, with those where the same balls rest."""
    kept = [tracklet.extent > MOVES for tracklet in tracklets]
    grows = True
    while grows:
        grows = False
        for index, tracklet in enumerate(tracklets):
            if kept[index]:
                continue
            if any(
                is_kept and (_continues(tracklet, other) or _continues(other, tracklet))
                for is_kept, other in zip(kept, tracklets, strict=True)
            ):
                kept[index] = grows = True
    return [tracklet for is_kept, tracklet in zip(kept, tracklets, strict=True) if is_kept]


def _continues(before: Tracklet, after: Tracklet) -> bool:
    if not 0 < after.first - before.last <= LONGEST_GAP:
        return False
    apart = np.linalg.norm(after.positions_px[0] - before.positions_px[-1])
    return bool(apart < CONTINUES * min(before.radius_px, after.radius_px))


def _joined(
    going: Sequence[Tracklet], before: Float[np.ndarray, "going colors"], found: Detections
) -> dict[int, int]:
    """Return the unambiguous detection of each tracklet, in the order of the tracklets."""
    if not len(found.positions_px) or not going:
        return {}
    expected = np.stack([p.positions_px[-1] + p.velocity_px(at_end=True) for p in going])
    radii = np.array([p.radii_px[-1] for p in going])
    larger = np.maximum(radii[:, None], found.radii_px)
    apart = np.linalg.norm(expected[:, None] - found.positions_px, axis=-1) / larger
    shared = np.minimum(before[:, None], found.colors).sum(axis=-1)
    cost = apart + COLOR_COST * (1 - shared)
    limit = FARTHEST + COLOR_COST
    chosen: dict[int, int] = {}
    for tracklet, row in zip(*linear_sum_assignment(np.minimum(cost, limit)), strict=True):
        others = np.concatenate([np.delete(cost[tracklet], row), np.delete(cost[:, row], tracklet)])
        if apart[tracklet, row] <= FARTHEST and (others > cost[tracklet, row] + CLEARER).all():
            chosen[int(tracklet)] = int(row)
    return dict(sorted(chosen.items()))
