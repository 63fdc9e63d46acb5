"""Claims of the paper about its tables, and verdicts from the measured figures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from training.reporting.results import Measurement
from training.studies.rows import COMPACT, MIDDLE
from training.studies.rows import PLAIN as WITHOUT

Outcome: TypeAlias = Literal["holds", "does not hold", "within the spread", "not decided"]
Cells: TypeAlias = Mapping[tuple[str, int, str, str, str], Measurement]
"""Cells by scenario, number of balls, method, moment and condition."""

BOWLS = ("hemisphere", "ellipsoid")
SCENARIOS = (*BOWLS, "heightfield")
OURS = (f"{COMPACT}posnet", f"{COMPACT}dispnet", f"{COMPACT}probnet")
POSNET, DISPNET, PROBNET = OURS
NO_MODULE = " without interaction module"
AT_CHANCE = 0.9
"""Share of the error of the middle of the frame from which on a row has learned nothing to compare.
"""


@dataclass(frozen=True)
class Comparison:
    """Two cells of a table, of which the first should have the smaller error.

    Attributes
    ----------
    worse_at, worse_condition
        Of the second cell, where they differ from the first one's.
    factor
        Multiple of the second error that the first should stay below.
    """

    scenario: str
    objects: int
    better: str
    worse: str
    at: str
    condition: str = ""
    worse_at: str | None = None
    worse_condition: str | None = None
    factor: float = 1.0


@dataclass(frozen=True)
class Claim:
    """A conclusion of the paper.

    Attributes
    ----------
    comparisons
        All of them have to hold, or as many as ``least`` says.
    """

    study: str
    text: str
    comparisons: tuple[Comparison, ...]
    least: int | None = None


@dataclass(frozen=True)
class Verdict:
    """Verdict of the measured figures on a claim."""

    claim: Claim
    outcome: Outcome
    figures: str


def verdicts(claims: Sequence[Claim], cells: Sequence[Measurement]) -> list[Verdict]:
    """Judge claims by measured cells."""
    known = {(c.scenario, c.objects, c.method, c.at, c.condition): c for c in cells}
    return [_verdict(claim, known) for claim in claims]


def _verdict(claim: Claim, cells: Cells) -> Verdict:
    outcomes: list[Outcome] = []
    figures: list[str] = []
    for one in claim.comparisons:
        place, worse_at = (one.scenario, one.objects), one.worse_at or one.at
        condition = one.condition if one.worse_condition is None else one.worse_condition
        better = cells.get((*place, one.better, one.at, one.condition))
        worse = cells.get((*place, one.worse, worse_at, condition))
        middles = [cells.get((*place, MIDDLE, at, one.condition)) for at in (one.at, worse_at)]
        outcomes.append(compared(better, worse, one.factor, middles))
        if better is not None and worse is not None:
            there = "" if worse_at == one.at else f" at {worse_at}"
            figures.append(
                f"{one.better} {better.position_error_px:.1f}, "
                f"{one.worse} {worse.position_error_px:.1f}{there} ({one.scenario}, {one.at})"
            )
    needed = len(claim.comparisons) if claim.least is None else claim.least
    return Verdict(claim, _together(outcomes, needed), "; ".join(figures) or "none yet")


def _together(outcomes: Sequence[Outcome], needed: int) -> Outcome:
    """Return a claim's outcome from those of its comparisons."""
    held, tied = outcomes.count("holds"), outcomes.count("within the spread")
    undecided = outcomes.count("not decided")
    if held >= needed:
        return "holds"
    if held + tied + undecided < needed:
        return "does not hold"
    return "within the spread" if held + undecided < needed else "not decided"


def compared(
    better: Measurement | None,
    worse: Measurement | None,
    factor: float,
    middles: Sequence[Measurement | None],
) -> Outcome:
    """Return the outcome of one comparison.

    It is not decided while a cell is missing, while both rows err like the middle of the frame, or
    while the row that is behind could still catch up: its training has not converged. Within the
    spread are differences below two standard errors of the test scenes and the spread over seeds.

    Parameters
    ----------
    middles
        Error of the middle of the frame beside each cell, where it is known.
    """
    if better is None or worse is None:
        return "not decided"
    if all(
        middle is not None and cell.position_error_px > AT_CHANCE * middle.position_error_px
        for cell, middle in zip((better, worse), middles, strict=True)
    ):
        return "not decided"
    ahead = factor * worse.position_error_px - better.position_error_px
    behind = worse if ahead > 0 else better
    if behind.training_sequences is not None and not behind.converged:
        return "not decided"
    if abs(ahead) <= math.hypot(spread(better), factor * spread(worse)):
        return "within the spread"
    return "holds" if ahead > 0 else "does not hold"


def spread(cell: Measurement) -> float:
    """Return how far chance may have moved a cell, in px."""
    return math.hypot(2 * cell.standard_error_px, cell.seed_spread_px or 0.0)


def _each(
    better: str, worse: str, at: str, scenarios: Sequence[str] = SCENARIOS
) -> tuple[Comparison, ...]:
    return tuple(Comparison(scenario, 1, better, worse, at) for scenario in scenarios)


def _of_several(better: str, worse: str, at: str) -> tuple[Comparison, ...]:
    return tuple(Comparison("ellipsoid", objects, better, worse, at) for objects in (2, 3))


def _of_ours(of: Callable[[str], tuple[Comparison, ...]]) -> tuple[Comparison, ...]:
    return tuple(one for name in OURS for one in of(name))


CLAIMS = (
    Claim(
        "long-term",
        "Networks from frames beat networks from states (NPE, IFS) up to T_train: PosNet in every "
        "scenario",
        (*_each(POSNET, "npe", "T=20"), *_each(POSNET, "ifs", "T=20")),
    ),
    Claim(
        "long-term",
        "Observing the ground helps most on heightfields: PosNet, DispNet and ProbNet beat NPE and "
        "IFS at T_train",
        (
            *_of_ours(lambda name: _each(name, "npe", "T=20", ("heightfield",))),
            *_of_ours(lambda name: _each(name, "ifs", "T=20", ("heightfield",))),
        ),
    ),
    Claim(
        "long-term",
        "PosNet beats V-LSTM and VIN at T_train in every scenario",
        (
            *_each(POSNET, "v-lstm", "T=20"),
            *_each(POSNET, f"vin{WITHOUT}", "T=20"),
        ),
    ),
    Claim(
        "long-term",
        "VIN is inaccurate even at T_train: V-LSTM beats it in every scenario",
        _each(f"v-lstm{WITHOUT}", f"vin{WITHOUT}", "T=20"),
    ),
    Claim(
        "long-term",
        "Beyond T_train, methods from states generalise better: NPE beats PosNet at T_gen in bowls",
        _each("npe", POSNET, "T=40", BOWLS),
    ),
    Claim(
        "long-term",
        "Learning angular velocity helps at T_gen: PosNet, DispNet and ProbNet are better with it "
        "in most of nine cells",
        _of_ours(lambda name: _each(name, f"{name}{WITHOUT}", "T=40")),
        least=7,
    ),
    Claim(
        "long-term",
        "Learned methods, including NPE and IFS, beat both polynomials at T_gen in every scenario",
        (
            *_each("npe", "linear extrapolation", "T=40"),
            *_each("ifs", "linear extrapolation", "T=40"),
            *_each("npe", "quadratic", "T=40"),
            *_each("ifs", "quadratic", "T=40"),
        ),
    ),
    Claim(
        "several-balls",
        "Without a collision module, the networks are competitive with NPE: DispNet beats it at "
        "T_train with two balls",
        (Comparison("ellipsoid", 2, DISPNET, "npe", "T=15"),),
    ),
    Claim(
        "several-balls",
        "IFS is the best method at T_gen",
        (*_of_several("ifs", "npe", "T=30"), *_of_several("ifs", POSNET, "T=30")),
    ),
    Claim(
        "several-balls",
        "PosNet beats V-LSTM at T_train and T_gen",
        (*_of_several(POSNET, "v-lstm", "T=15"), *_of_several(POSNET, "v-lstm", "T=30")),
    ),
    Claim(
        "interaction",
        "The interaction module helps DispNet at T_gen",
        _of_several(DISPNET, f"{DISPNET}{NO_MODULE}", "T=30"),
    ),
    Claim(
        "collisions",
        "The interaction module helps DispNet after a collision, with two balls and with three",
        tuple(
            replace(one, condition="before the first collision")
            for steps in (5, 10)
            for one in _of_several(DISPNET, f"{DISPNET}{NO_MODULE}", f"{steps} after the collision")
        ),
    ),
    Claim(
        "interpolation",
        "A final frame helps: InterpNet beats DispNet trained to T at T = 20 and later, by most "
        "where DispNet is worst",
        tuple(
            one
            for at in ("T=20", "T=30", "T=40")
            for one in _each(f"{COMPACT}interpnet", f"{DISPNET} trained to T", at)
        ),
    ),
    Claim(
        "texture",
        "Texture has little effect: errors of PosNet, DispNet and ProbNet with white balls are "
        "less than 1.25 times those with textured balls in at least ten of twelve cells",
        tuple(
            Comparison(
                "ellipsoid", 1, name, name, at, "white balls", worse_condition="", factor=1.25
            )
            for name in (*OURS, *(f"{name}{WITHOUT}" for name in OURS))
            for at in ("T=20", "T=40")
        ),
        least=10,
    ),
    Claim(
        "supervision",
        "Networks are most accurate up to the horizon of their supervision: PosNet, DispNet and "
        "ProbNet supervised to T = 40 beat those supervised to T = 20 at T = 40",
        _of_ours(lambda name: _each(f"{name} supervised to T=40", name, "T=40")),
    ),
    Claim(
        "interpolation",
        "InterpNet has its largest error in the middle: at T = 20 larger than at T = 40",
        tuple(
            replace(one, worse_at="T=20")
            for one in _each(f"{COMPACT}interpnet", f"{COMPACT}interpnet", "T=40")
        ),
    ),
    Claim(
        "long-term",
        "The likelihood helps: ProbNet beats DispNet in most of twelve cells",
        tuple(
            one
            for at in ("T=20", "T=40")
            for suffix in ("", WITHOUT)
            for one in _each(f"{PROBNET}{suffix}", f"{DISPNET}{suffix}", at)
        ),
        least=7,
    ),
)
