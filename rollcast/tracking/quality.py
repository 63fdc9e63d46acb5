"""Quality report of tracks: shares found, gaps, and possible swaps."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel

from rollcast.tracking.tracks import Tracks

NEAR = 2.6
"""Radii between the centres of balls that may be mistaken for each other."""
JUMP = 3.0
"""Minimum distance of a jump from the extrapolated position, in radii."""


class Gap(BaseModel):
    """Frames in which a ball was not found, from ``first`` to ``last``."""

    ball: int
    first: int
    last: int
    seconds: float


class CloseApproach(BaseModel):
    """Two balls that were close, after which they may have been mistaken for each other."""

    balls: tuple[int, int]
    first: int
    last: int
    evidence: float
    """Log likelihood ratio of the assignment by colour, nats; small or negative is uncertain."""


class Jump(BaseModel):
    """A ball that is suddenly elsewhere: a hard impact, or a mistake."""

    ball: int
    frame: int
    radii: float


class BallQuality(BaseModel):
    """Detection statistics of a ball."""

    ball: int
    color: str
    found: float
    """Share of the frames."""
    radius_px: float
    gaps: int
    longest_gap_s: float


class Quality(BaseModel):
    """Report on the tracks of a clip."""

    clip: str
    frames: int
    """Number of frames, without repeated ones."""
    repeated: int = 0
    """Number of frames that repeat the previous one."""
    seconds: float
    frame_rate: float
    found: float
    """Share of all frames and balls."""
    balls: list[BallQuality]
    gaps: list[Gap]
    suspected_swaps: list[CloseApproach]
    jumps: list[Jump]


UNCERTAIN = 5.0
"""Nats below which an encounter is a suspected swap."""


def quality_of(tracks: Tracks, approaches: Sequence[CloseApproach], repeated: int = 0) -> Quality:
    """Report on tracks.

    Parameters
    ----------
    approaches
        All of them, uncertain or not.
    repeated
        Number of frames that were left out.
    """
    gaps = [gap for ball in range(tracks.balls) for gap in _gaps(tracks, ball)]
    of_balls: list[BallQuality] = []
    for ball, color in enumerate(tracks.colors):
        own = [gap for gap in gaps if gap.ball == ball]
        of_balls.append(
            BallQuality(
                ball=ball,
                color=color,
                found=float(tracks.found[:, ball].mean()),
                radius_px=round(float(np.nanmedian(tracks.radii_px[:, ball])), 2),
                gaps=len(own),
                longest_gap_s=max((gap.seconds for gap in own), default=0.0),
            )
        )
    seconds = float(tracks.times_s[-1] - tracks.times_s[0])
    return Quality(
        clip=tracks.clip,
        frames=len(tracks.times_s),
        repeated=repeated,
        seconds=round(seconds, 3),
        frame_rate=round((len(tracks.times_s) - 1) / seconds, 3),
        found=float(tracks.found.mean()),
        balls=of_balls,
        gaps=gaps,
        suspected_swaps=[one for one in approaches if one.evidence < UNCERTAIN],
        jumps=[jump for ball in range(tracks.balls) for jump in _jumps(tracks, ball)],
    )


def runs(wanted: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wanted.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def _gaps(tracks: Tracks, ball: int) -> list[Gap]:
    spacing_s = float(np.median(np.diff(tracks.times_s)))
    return [
        Gap(
            ball=ball,
            first=first,
            last=last,
            seconds=round(float(tracks.times_s[last] - tracks.times_s[first]) + spacing_s, 3),
        )
        for first, last in runs(~tracks.found[:, ball])
    ]


def _jumps(tracks: Tracks, ball: int) -> list[Jump]:
    seen = np.flatnonzero(tracks.found[:, ball])
    radius_px = float(np.nanmedian(tracks.radii_px[:, ball]))
    jumps: list[Jump] = []
    for before, last, now in zip(seen, seen[1:], seen[2:], strict=False):
        there, went, came = tracks.positions_px[[before, last, now], ball]
        span = (now - last) / (last - before)
        radii = float(np.linalg.norm(came - went - span * (went - there))) / radius_px
        # A ball that stops or bounces has a change of its own speed; a jump is more than that.
        change = 2.2 * float(np.linalg.norm(span * (went - there))) / radius_px
        if radii > JUMP + change:
            jumps.append(Jump(ball=ball, frame=int(now), radii=round(radii, 2)))
    return jumps
