# pyright: standard
"""Tracklets: detections in consecutive frames that belong together without ambiguity."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from rollcast.tracking.detection import Detections

FARTHEST = 5.0
"""Radii from where a ball is expected, beyond which it is another one."""
COLOUR_COST = 3.0
"""Of colours that have nothing in common, as much as so many radii."""
CLEARER = 1.0
"""By which the next best pair has to cost more; else both end and are joined later."""
HISTORY = 4
"""Frames from which a velocity is known."""


@dataclass
class Tracklet:
    """One detection in each of some frames that follow each other.

    Attributes
    ----------
    first
        Number of its first frame.
    rows
        Index of its detection in every frame.
    positions_px
        Centres [frames][2].
    """

    first: int
    rows: list[int] = field(default_factory=list[int])
    positions_px: list[Float[np.ndarray, "2"]] = field(default_factory=list[np.ndarray])

    @property
    def last(self) -> int:
        """Number of its last frame."""
        return self.first + len(self.rows) - 1

    def velocity_px(self, *, at_end: bool) -> Float[np.ndarray, "2"]:
        """Displacement a frame near an end; 0 where there is but one frame."""
        few = self.positions_px[-HISTORY:] if at_end else self.positions_px[:HISTORY]
        if len(few) < 2:
            return np.zeros(2)
        # An impact makes the mean wrong for longer than it makes the last displacement.
        return np.median(np.diff(np.stack(few), axis=0), axis=0)

    def add(self, row: int, position_px: Float[np.ndarray, "2"]) -> None:
        """Go on to the next frame."""
        self.rows.append(row)
        self.positions_px.append(position_px)


def link_tracklets(frames: Sequence[Detections], radius_px: float) -> list[Tracklet]:
    """Join the detections of neighbouring frames where the match is unambiguous.

    Parameters
    ----------
    radius_px
        Approximate radius of the balls.
    """
    ended: list[Tracklet] = []
    going: list[Tracklet] = []
    for number, found in enumerate(frames):
        joined = _joined(going, frames[number - 1], found, radius_px) if going else {}
        still = [tracklet for index, tracklet in enumerate(going) if index in joined]
        ended += [tracklet for index, tracklet in enumerate(going) if index not in joined]
        for tracklet, row in zip(still, joined.values(), strict=True):
            tracklet.add(row, found.positions_px[row])
        taken = set(joined.values())
        for row, position in enumerate(found.positions_px):
            if row not in taken:
                tracklet = Tracklet(number)
                tracklet.add(row, position)
                still.append(tracklet)
        going = still
    return sorted(ended + going, key=lambda tracklet: tracklet.first)


def _joined(
    going: Sequence[Tracklet], before: Detections, found: Detections, radius_px: float
) -> dict[int, int]:
    """Return the detection of each tracklet that surely goes on, in the order of the tracklets."""
    if not len(found.positions_px):
        return {}
    expected = np.stack([p.positions_px[-1] + p.velocity_px(at_end=True) for p in going])
    apart = np.linalg.norm(expected[:, None] - found.positions_px, axis=-1) / radius_px
    mine = before.colours[[tracklet.rows[-1] for tracklet in going]]
    shared = np.minimum(mine[:, None], found.colours).sum(axis=-1)
    cost = apart + COLOUR_COST * (1 - shared)
    limit = FARTHEST + COLOUR_COST
    chosen: dict[int, int] = {}
    for tracklet, row in zip(*linear_sum_assignment(np.minimum(cost, limit)), strict=True):
        others = np.concatenate([np.delete(cost[tracklet], row), np.delete(cost[:, row], tracklet)])
        if apart[tracklet, row] <= FARTHEST and (others > cost[tracklet, row] + CLEARER).all():
            chosen[int(tracklet)] = int(row)
    return dict(sorted(chosen.items()))
