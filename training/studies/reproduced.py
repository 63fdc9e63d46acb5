"""``docs/reproduced.md``: what of the paper holds here, what does not, and what cannot be told."""

from collections.abc import Sequence

from rollcast.markdown import table
from training.reporting.results import Measurement, Results
from training.studies.claims import CLAIMS, Outcome, Verdict, verdicts

NAME = "reproduced.md"
NEAR = 1.5
"""Multiple of the paper's error up to which a cell counts as near it."""
TABLES = ("long-term", "several-balls", "interpolation", "texture", "interaction", "collisions")
OUTCOMES: tuple[Outcome, ...] = ("holds", "does not hold", "within the spread", "not decided")
DIFFERENCES = (
    ("Networks", "VGG16 with ImageNet's weights, an 8 x 8 x 512 state", "compact- rows: an "
     "8 x 8 x 128 state from nothing; the published ones train by a command (paper-posnet, "
     "paper-dispnet, paper-probnet, paper-interpnet), none of which was run to its end here"),
    ("Committed models", "positions and angular velocities of frames alone",
     "taught ground, heights and 3-D velocities too, so their errors are no evidence for the "
     "paper's idea of a state that is induced from positions"),
    ("Budget", "about 17 million sequences of 8,750 (4,480 on heightfields) simulations",
     "the columns of every table; 1,200 to 1,800 simulations of each kind"),
    ("ProbNet's regulariser", "a sum over the steps", "a mean over the steps in compact-probnet, "
     "as its weight was tuned with it; the sum in paper-probnet"),
    ("Two balls that collide", "restitution 0.7 each, of which Bullet takes the product, 0.49",
     "0.7 for the pair"),
    ("Frames", "rendered at 256 pixels, stored as JPEG, scaled down to 128", "rendered at 128"),
    ("Radii", "0.04 m and 0.225 m", "0.225 m on every page; small balls in a few bowls of the "
     "training alone"),
    ("NPE", "four past states by the paper's caption", "two, as in its published code"),
    ("V-LSTM", "AlexNet with ImageNet's weights", "AlexNet from nothing"),
    ("VIN", "six frames in its own publication", "the four that all methods see"),
    ("Batches from states", "50 (NPE) and 4 (IFS) for a million steps and more",
     "1,000 and 128, down a cosine that ends with the budget"),
    ("Real footage", "six methods on Roll4Real", "other clips; no rows of PosNet, DispNet and "
     "ProbNet"),
)  # fmt: skip
"""What, in the paper, and here."""

PAGE = """<!-- Made by `python -m training report`; do not edit. -->
# What we reproduced

Two minutes on how far this repository bears out "Taking Visual Motion Prediction To New
Heightfields". Every figure is in the tables that the claims link to.

**{counts}**

A claim is *not decided* while a row that it rests on is missing, has not converged (its validation
error fell by 2 % or more over the last fifth of its training, or convergence was not tested), or
errs like a network that always says the middle of the frame. *Within the spread* are differences
that test scenes and seeds alone would explain.

{claims}

## How near the errors are

Cells of a row whose error is at most {near} times the paper's, of those that the paper prints too.
These rows had far smaller budgets than the paper's; the committed models are not among them, for
they were taught more.

{cells}

## What differs

{differences}
"""


def page(results: Results) -> str:
    """Return the page."""
    found = [
        verdict
        for study in dict.fromkeys(claim.study for claim in CLAIMS)
        for verdict in verdicts(
            [claim for claim in CLAIMS if claim.study == study], results.of(study).cells
        )
    ]
    return PAGE.format(
        counts=_counts(found),
        claims=table(
            ("the paper's claim", "here"),
            [
                (f"[{one.claim.text}](results/{one.claim.study}.md)", one.outcome)
                for one in sorted(found, key=lambda one: OUTCOMES.index(one.outcome))
            ],
        ),
        near=NEAR,
        cells=_near(results.cells),
        differences=table(("", "the paper", "here"), DIFFERENCES),
    )


def _counts(found: Sequence[Verdict]) -> str:
    said = [one.outcome for one in found]
    parts = [f"{said.count(outcome)} {outcome}" for outcome in OUTCOMES]
    return f"Of {len(said)} claims: {', '.join(parts)}."


def _near(cells: Sequence[Measurement]) -> str:
    """Return a line a method: how many of its cells are near the paper's."""
    by_method: dict[str, list[bool]] = {}
    for cell in cells:
        if cell.study in TABLES and cell.paper_px is not None:
            near = cell.position_error_px <= NEAR * cell.paper_px
            by_method.setdefault(cell.method, []).append(near)
    rows = [(name, f"{sum(near)} of {len(near)}") for name, near in sorted(by_method.items())]
    return table(("row", f"cells within {NEAR} times the paper's"), rows)
