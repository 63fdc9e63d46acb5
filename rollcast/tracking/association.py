# pyright: standard
"""Which tracklets of tracks are one ball: by its colours, and by where it went on.

A ball is known by its palette: how often each colour is seen on it, from all sides. Palettes and
tracklets are found in turn, as in expectation-maximisation: an integer program (HiGHS, through
scipy) assigns tracklets to balls, and palettes follow from the tracklets.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

from rollcast.errors import FootageError
from rollcast.tracking.colors import BINS, COLORS
from rollcast.tracking.tracklets import LONGEST_GAP, Tracklet

ROUNDS = 3
BEGINNINGS = 2
"""Number of sets of tracklets that initialise palettes."""
OUTLIER_RATE = 0.02
"""Share of a ball's pixels that may have any colour: reflections, dirt."""
COLOR_WEIGHT = 0.3
"""Weight of a frame's colours, which correlate with those of neighbouring frames."""
SUREST = 4.0
"""Maximum log likelihood ratio of one frame's colours, in nats."""
CONTINUED = 12.0
"""Value, in nats, of a continuation along the velocity of the ball."""
MAX_DRIFT = 0.6
"""Radii by which a ball may stray a frame while it is not seen."""
SUCCESSORS = 3
"""Maximum successors of a tracklet: the nearest ones to its extrapolated position."""
GAP = 0.01
"""Relative gap to the optimum at which the solver stops."""
SOLVER_S = 30.0
"""Time limit of one program, whose best assignment so far is used."""


@dataclass(frozen=True)
class Identities:
    """Pieces by ball.

    Attributes
    ----------
    balls
        Index of the ball of each tracklet; -1 for outliers.
    palettes
        Shares of a ball's pixels by colour.
    value
        Log likelihood of the assignment, in nats.
    """

    balls: list[int]
    palettes: Float[np.ndarray, "balls colors"]
    value: float


def balls_in(tracklets: Sequence[Tracklet], frames: int, most: int) -> int:
    """Return how many balls there seem to be: as many as long tracklets stand side by side."""
    counts = np.zeros(frames, int)
    for tracklet in tracklets:
        if len(tracklet) >= min(10, frames // 4):
            counts[tracklet.first : tracklet.last + 1] += 1
    likely = [n for n in range(1, most + 1) if np.mean(counts >= n) > 0.2]
    return max(likely, default=1)


def assign_identities(tracklets: Sequence[Tracklet], frames: int, balls: int) -> Identities:
    """Say which ball each tracklet shows.

    Parameters
    ----------
    frames
        Number of the clip's.
    """
    seen = np.stack([tracklet.mean_colors for tracklet in tracklets])
    lengths = np.array([len(tracklet) for tracklet in tracklets])
    radius_px = float(np.median([tracklet.radius_px for tracklet in tracklets]))
    found: list[Identities] = []
    for beginning in _beginnings(tracklets, balls, frames):
        palettes = _palettes(seen[beginning] * lengths[beginning, None])
        for _ in range(ROUNDS):
            worth = palette_evidence(seen, palettes) * lengths[:, None]
            given, value = _given(tracklets, worth, radius_px)
            now = Identities(given, palettes, value)
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
    seen: Float[np.ndarray, "tracklets colors"], palettes: Float[np.ndarray, "balls colors"]
) -> Float[np.ndarray, "tracklets balls"]:
    """Log likelihood ratio of colours under each palette and under chance, nats per frame."""
    usual = (1 - OUTLIER_RATE) * palettes + OUTLIER_RATE / COLORS
    return np.clip(COLOR_WEIGHT * seen @ np.log(usual * COLORS).T, -SUREST, SUREST)


def _palettes(sums: Float[np.ndarray, "balls colors"]) -> Float[np.ndarray, "balls colors"]:
    """Shares of neighbouring colours, smoothed: light changes over a picture."""
    smooth = gaussian_filter(sums.reshape(-1, *BINS), (0, 0.4, 0.6, 0.6), mode="nearest")
    flat = smooth.reshape(len(sums), -1) + 1e-9
    return flat / flat.sum(axis=1, keepdims=True)


def _beginnings(tracklets: Sequence[Tracklet], balls: int, frames: int) -> list[list[int]]:
    """Return sets of tracklets that stand side by side, one a ball, the longest ones."""
    candidates: dict[tuple[int, ...], float] = {}
    for number in range(0, frames, max(1, frames // 200)):
        alive = [
            i for i, tracklet in enumerate(tracklets) if tracklet.first <= number <= tracklet.last
        ]
        alive = sorted(alive, key=lambda i: -len(tracklets[i]))[: balls + 2]
        for chosen in combinations(sorted(alive), min(balls, len(alive))):
            if len(chosen) == balls:
                candidates[chosen] = min(len(tracklets[i]) for i in chosen)
    if not candidates:  # never all of them at once
        longest = sorted(range(len(tracklets)), key=lambda i: -len(tracklets[i]))
        return [longest[:balls]]
    best = sorted(candidates, key=lambda chosen: -candidates[chosen])
    return [list(chosen) for chosen in best[:BEGINNINGS]]


def _given(
    tracklets: Sequence[Tracklet], worth: Float[np.ndarray, "tracklets balls"], radius_px: float
) -> tuple[list[int], float]:
    """Give tracklets to balls so that colours and continued ways are worth the most together.

    Variables are x[tracklet, ball] and, for tracklets that may continue each other,
    y[pair, ball]. A ball is in one place at a time; a tracklet is of one ball; y needs both of its
    tracklets, and at most one other tracklet continues a tracklet.
    """
    count, balls = worth.shape
    pairs = _pairs(tracklets, radius_px)
    gains = np.concatenate([worth.ravel(), np.repeat([gain for *_, gain in pairs], balls)])
    rows: list[tuple[list[int], list[float], float]] = []

    def x(tracklet: int, ball: int) -> int:
        return tracklet * balls + ball

    def y(pair: int, ball: int) -> int:
        return (count + pair) * balls + ball

    for tracklet in range(count):
        rows.append(([x(tracklet, ball) for ball in range(balls)], [1.0] * balls, 1.0))
        together = [
            other for other in range(count)
            if tracklets[other].first <= tracklets[tracklet].first <= tracklets[other].last
        ]  # fmt: skip
        if len(together) > 1:
            for ball in range(balls):
                rows.append(([x(o, ball) for o in together], [1.0] * len(together), 1.0))
    for end in (0, 1):
        ends = [(before, after)[end] for before, after, _ in pairs]
        for tracklet in sorted(set(ends)):
            own = [index for index, other in enumerate(ends) if other == tracklet]
            for ball in range(balls):
                indices = [*(y(index, ball) for index in own), x(tracklet, ball)]
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
        # Continuations follow from who owns the tracklets.
        integrality=np.repeat([1, 0], [worth.size, len(pairs) * balls]),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix.tocsr(), -np.inf, limits),  # pyright: ignore[reportArgumentType]
        options={"time_limit": SOLVER_S, "mip_rel_gap": GAP},
    )
    if solved.x is None:
        raise FootageError(
            f"{count} tracks of moving objects cannot be assigned to {balls} balls; exclude other "
            "moving objects with --crop, or set the number of balls with --balls"
        )
    chosen = solved.x[: count * balls].reshape(count, balls)
    given = [int(row.argmax()) if row.max() > 0.5 else -1 for row in chosen]
    return given, float(-solved.fun)


def _pairs(tracklets: Sequence[Tracklet], radius_px: float) -> list[tuple[int, int, float]]:
    """Pairs of tracklets of which the second may continue the first, with their value in nats."""
    pairs: list[tuple[int, int, float]] = []
    for i, before in enumerate(tracklets):
        own: list[tuple[int, int, float]] = []
        for j in range(i + 1, len(tracklets)):
            after = tracklets[j]
            gap = after.first - before.last
            if gap > LONGEST_GAP:
                break
            if gap < 1:
                continue
            strays = _strays_px(before, after, gap) / radius_px
            gain = CONTINUED - (strays / (0.5 + MAX_DRIFT * gap)) ** 2
            if gain > 0:
                own.append((i, j, gain))
        pairs += sorted(own, key=lambda pair: -pair[-1])[:SUCCESSORS]
    return pairs


def _strays_px(before: Tracklet, after: Tracklet, gap: int) -> float:
    """Smaller distance between two tracklets if either one is extrapolated.

    After an impact between them, only one of the two velocities is valid.
    """
    end, begin = before.positions_px[-1], after.positions_px[0]
    forth = end + gap * before.velocity_px(at_end=True) - begin
    back = begin - gap * after.velocity_px(at_end=False) - end
    return float(min(np.linalg.norm(forth), np.linalg.norm(back)))
