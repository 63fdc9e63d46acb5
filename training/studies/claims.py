"""What the paper concludes from its tables, claim by claim, and whether it holds here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from training.reporting.results import Measurement

Outcome: TypeAlias = Literal["holds", "does not hold", "open"]
Errors: TypeAlias = Mapping[tuple[str, int, str, str, str], float]
"""Position errors in pixels by scenario, number of balls, method, moment and condition."""

BOWLS = ("hemisphere", "ellipsoid")
SCENARIOS = (*BOWLS, "heightfield")
OURS = ("posnet", "dispnet", "probnet")
WITHOUT = " without angular velocity"
NO_MODULE = " without interaction module"


@dataclass(frozen=True)
class Comparison:
    """Two cells of a table, of which the first should have the smaller error."""

    scenario: str
    objects: int
    better: str
    worse: str
    at: str
    condition: str = ""


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
    """What our figures say of a claim; "open" while cells are missing."""

    claim: Claim
    outcome: Outcome
    figures: str


def verdicts(claims: Sequence[Claim], cells: Sequence[Measurement]) -> list[Verdict]:
    """Judge claims by measured cells."""
    errors = {
        (c.scenario, c.objects, c.method, c.at, c.condition): c.position_error_px for c in cells
    }
    return [_verdict(claim, errors) for claim in claims]


def _verdict(claim: Claim, errors: Errors) -> Verdict:
    held, broken, missing = 0, 0, 0
    figures: list[str] = []
    for one in claim.comparisons:
        better = errors.get((one.scenario, one.objects, one.better, one.at, one.condition))
        worse = errors.get((one.scenario, one.objects, one.worse, one.at, one.condition))
        if better is None or worse is None:
            missing += 1
            continue
        held, broken = held + (better < worse), broken + (better >= worse)
        figures.append(
            f"{one.better} {better:.1f}, {one.worse} {worse:.1f} ({one.scenario}, {one.at})"
        )
    needed = len(claim.comparisons) if claim.least is None else claim.least
    outcome: Outcome = "open"
    if held >= needed:
        outcome = "holds"
    elif held + missing < needed:
        outcome = "does not hold"
    return Verdict(claim, outcome, "; ".join(figures) or "none yet")


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
        "Networks from frames beat those from states (NPE, IFS) up to T_train: PosNet in every "
        "scenario",
        (*_each("posnet", "npe", "T=20"), *_each("posnet", "ifs", "T=20")),
    ),
    Claim(
        "long-term",
        "On heightfields seeing the ground pays most: PosNet, DispNet and ProbNet beat NPE and IFS "
        "at T_train",
        (
            *_of_ours(lambda name: _each(name, "npe", "T=20", ("heightfield",))),
            *_of_ours(lambda name: _each(name, "ifs", "T=20", ("heightfield",))),
        ),
    ),
    Claim(
        "long-term",
        "PosNet beats V-LSTM and VIN at T_train in every scenario",
        (
            *_each("posnet", "v-lstm", "T=20"),
            *_each("posnet", f"vin{WITHOUT}", "T=20"),
        ),
    ),
    Claim(
        "long-term",
        "VIN fails even at T_train: V-LSTM beats it in every scenario",
        _each(f"v-lstm{WITHOUT}", f"vin{WITHOUT}", "T=20"),
    ),
    Claim(
        "long-term",
        "Beyond T_train methods from states keep up better: NPE beats PosNet at T_gen in bowls",
        _each("npe", "posnet", "T=40", BOWLS),
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
        "Learned methods beat both polynomials at T_gen in every scenario, NPE and IFS among them",
        (
            *_each("npe", "line", "T=40"),
            *_each("ifs", "line", "T=40"),
            *_each("npe", "quadratic", "T=40"),
            *_each("ifs", "quadratic", "T=40"),
        ),
    ),
    Claim(
        "several-balls",
        "Without a collision module the networks compete with NPE: DispNet beats it at T_train "
        "with two balls",
        (Comparison("ellipsoid", 2, "dispnet", "npe", "T=15"),),
    ),
    Claim(
        "several-balls",
        "IFS is the best of all at T_gen",
        (*_of_several("ifs", "npe", "T=30"), *_of_several("ifs", "posnet", "T=30")),
    ),
    Claim(
        "several-balls",
        "PosNet beats V-LSTM at T_train and T_gen",
        (*_of_several("posnet", "v-lstm", "T=15"), *_of_several("posnet", "v-lstm", "T=30")),
    ),
    Claim(
        "interaction",
        "The module for several balls helps DispNet at T_gen",
        _of_several("dispnet", f"dispnet{NO_MODULE}", "T=30"),
    ),
    Claim(
        "collisions",
        "The module helps DispNet after a collision, with two balls and with three",
        tuple(
            replace(one, condition="before the first collision")
            for steps in (5, 10)
            for one in _of_several("dispnet", f"dispnet{NO_MODULE}", f"{steps} after the collision")
        ),
    ),
    Claim(
        "interpolation",
        "A final frame helps: InterpNet beats DispNet trained to T at T = 20 and later, most where "
        "DispNet is worst",
        tuple(
            one
            for at in ("T=20", "T=30", "T=40")
            for one in _each("interpnet", "dispnet trained to T", at)
        ),
    ),
)
