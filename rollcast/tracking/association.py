# pyright: standard
"""Which pieces of tracks are one ball: by its colours, and by where it went on.

A ball is known by its palette: how often each colour is seen on it, from all sides. Palettes and
pieces are found in turn, as in expectation-maximisation: pieces are given to balls by an integer
program (HiGHS, by way of scipy) whose optimum is exact, and palettes follow from the pieces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

from rollcast.tracking.detection import BINS, COLOURS, Detections
from rollcast.tracking.tracklets import Piece

ROUNDS = 4
BEGINNINGS = 3
"""Sets of pieces that palettes are begun with."""
STRANGER = 0.02
"""Share of a ball's pixels that may have any colour: reflections, dirt."""
COLOUR_WEIGHT = 0.3
"""Of a frame's colours: those of neighbouring frames say the same."""
SUREST = 4.0
"""Most that one frame's colours say, in nats."""
CONTINUED = 12.0
"""What it is worth, in nats, that a ball goes on where it was going."""
LONGEST_GAP = 30
"""Frames over which it can be told where a ball was going."""
STRAY = 0.6
"""Radii by which a ball may stray a frame while it is not seen."""
SOLVER_S = 60.0


@dataclass(frozen=True)
class Identified:
    """Pieces by ball.

    Attributes
    ----------
    balls
        Index of the ball of each piece; -1 for what is none.
    palettes
        Shares of a ball's pixels by colour.
    value
        How well it all fits, in nats.
    """

    balls: list[int]
    palettes: Float[np.ndarray, "balls colours"]
    value: float


def balls_in(pieces: Sequence[Piece], frames: int, most: int) -> int:
    """Return how many balls there seem to be: as many as long pieces stand side by side."""
    counts = np.zeros(frames, int)
    for piece in pieces:
        if len(piece.rows) >= min(10, frames // 4):
            counts[piece.first : piece.last + 1] += 1
    likely = [n for n in range(1, most + 1) if np.mean(counts >= n) > 0.2]
    return max(likely, default=1)


def identified(
    pieces: Sequence[Piece], frames: Sequence[Detections], balls: int, radius_px: float
) -> Identified:
    """Say which ball each piece shows.

    Parameters
    ----------
    radius_px
        Of the balls, about.
    """
    seen = np.stack([_colours(piece, frames) for piece in pieces])
    lengths = np.array([len(piece.rows) for piece in pieces])
    found: list[Identified] = []
    for beginning in _beginnings(pieces, balls, len(frames)):
        palettes = _palettes(seen[beginning] * lengths[beginning, None])
        for _ in range(ROUNDS):
            worth = palette_evidence(seen, palettes) * lengths[:, None]
            given, value = _given(pieces, worth, radius_px)
            now = Identified(given, palettes, value)
            sums = np.stack(
                [
                    (seen * lengths[:, None])[np.array(given) == ball].sum(axis=0)
                    for ball in range(balls)
                ]
            )
            palettes = _palettes(sums)
            if found and found[-1].balls == given:
                break
            found.append(now)
    return max(found, key=lambda one: one.value)


def palette_evidence(
    seen: Float[np.ndarray, "pieces colours"], palettes: Float[np.ndarray, "balls colours"]
) -> Float[np.ndarray, "pieces balls"]:
    """How much better each palette explains colours than chance does, nats a frame."""
    usual = (1 - STRANGER) * palettes + STRANGER / COLOURS
    return np.clip(COLOUR_WEIGHT * seen @ np.log(usual * COLOURS).T, -SUREST, SUREST)


def _colours(piece: Piece, frames: Sequence[Detections]) -> Float[np.ndarray, " colours"]:
    """Mean colours of a piece."""
    shown = [frames[piece.first + i].colours[row] for i, row in enumerate(piece.rows)]
    return np.mean(shown, axis=0).astype(np.float64)


def _palettes(sums: Float[np.ndarray, "balls colours"]) -> Float[np.ndarray, "balls colours"]:
    """Shares of neighbouring colours, smoothed: light changes over a picture."""
    smooth = gaussian_filter(sums.reshape(-1, *BINS), (0, 0.4, 0.6, 0.6), mode="nearest")
    flat = smooth.reshape(len(sums), -1) + 1e-9
    return flat / flat.sum(axis=1, keepdims=True)


def _beginnings(pieces: Sequence[Piece], balls: int, frames: int) -> list[list[int]]:
    """Return sets of pieces that stand side by side, one a ball, the longest ones."""
    candidates: dict[tuple[int, ...], float] = {}
    for number in range(0, frames, max(1, frames // 200)):
        alive = [i for i, piece in enumerate(pieces) if piece.first <= number <= piece.last]
        alive = sorted(alive, key=lambda i: -len(pieces[i].rows))[: balls + 2]
        for chosen in combinations(sorted(alive), min(balls, len(alive))):
            if len(chosen) == balls:
                candidates[chosen] = min(len(pieces[i].rows) for i in chosen)
    if not candidates:  # never all of them at once
        longest = sorted(range(len(pieces)), key=lambda i: -len(pieces[i].rows))
        return [longest[:balls]]
    best = sorted(candidates, key=lambda chosen: -candidates[chosen])
    return [list(chosen) for chosen in best[:BEGINNINGS]]


def _given(
    pieces: Sequence[Piece], worth: Float[np.ndarray, "pieces balls"], radius_px: float
) -> tuple[list[int], float]:
    """Give pieces to balls so that colours and continued ways are worth the most together.

    Variables are x[piece, ball] and, for pieces that may continue each other, y[pair, ball]. A ball
    is in one place at a time; a piece is of one ball; y needs both of its pieces, and a piece goes
    on in one other at most.
    """
    count, balls = worth.shape
    pairs = _pairs(pieces, radius_px)
    gains = np.concatenate([worth.ravel(), np.repeat([gain for *_, gain in pairs], balls)])
    rows: list[tuple[list[int], list[float], float]] = []

    def x(piece: int, ball: int) -> int:
        return piece * balls + ball

    def y(pair: int, ball: int) -> int:
        return (count + pair) * balls + ball

    for piece in range(count):
        rows.append(([x(piece, ball) for ball in range(balls)], [1.0] * balls, 1.0))
        together = [
            other for other in range(count)
            if pieces[other].first <= pieces[piece].first <= pieces[other].last
        ]  # fmt: skip
        if len(together) > 1:
            for ball in range(balls):
                rows.append(([x(o, ball) for o in together], [1.0] * len(together), 1.0))
    for end in (0, 1):
        ends = [(before, after)[end] for before, after, _ in pairs]
        for piece in sorted(set(ends)):
            own = [index for index, other in enumerate(ends) if other == piece]
            for ball in range(balls):
                indices = [*(y(index, ball) for index in own), x(piece, ball)]
                rows.append((indices, [1.0] * len(own) + [-1.0], 0.0))
    matrix = coo_array(
        (
            [value for _, values, _ in rows for value in values],
            (
                [row for row, (indices, _, _) in enumerate(rows) for _ in indices],
                [index for indices, _, _ in rows for index in indices],
            ),
        ),
        shape=(len(rows), len(gains)),
    )
    limits = np.array([limit for *_, limit in rows])
    solved = milp(
        -gains,
        integrality=np.ones(len(gains)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix.tocsr(), -np.inf, limits),  # pyright: ignore[reportArgumentType]
        options={"time_limit": SOLVER_S},
    )
    if solved.x is None:
        raise RuntimeError(f"HiGHS found no solution: {solved.message}")
    chosen = solved.x[: count * balls].reshape(count, balls)
    given = [int(row.argmax()) if row.max() > 0.5 else -1 for row in chosen]
    return given, float(-solved.fun)


def _pairs(pieces: Sequence[Piece], radius_px: float) -> list[tuple[int, int, float]]:
    """Pieces of which the second may continue the first, and what that is worth, nats."""
    pairs: list[tuple[int, int, float]] = []
    for i, before in enumerate(pieces):
        for j in range(i + 1, len(pieces)):
            after = pieces[j]
            gap = after.first - before.last
            if gap > LONGEST_GAP:
                break
            if gap < 1:
                continue
            strays = _strays_px(before, after, gap) / radius_px
            gain = CONTINUED - (strays / (0.5 + STRAY * gap)) ** 2
            if gain > 0:
                pairs.append((i, j, gain))
    return pairs


def _strays_px(before: Piece, after: Piece, gap: int) -> float:
    """By how much a piece misses the other if either goes on as it did: the smaller one.

    With an impact in between, only one of the two velocities was the ball's.
    """
    end, begin = before.positions_px[-1], after.positions_px[0]
    forth = end + gap * before.velocity_px(at_end=True) - begin
    back = begin - gap * after.velocity_px(at_end=False) - end
    return float(min(np.linalg.norm(forth), np.linalg.norm(back)))
