"""Rows of the tables: methods, their measurement, and methods without training."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.trajectory import OBSERVED_FRAMES
from training.baselines.least_squares import POINTS, polynomial
from training.baselines.oracle import Oracle
from training.common.settings import runs_folder
from training.objectives.metrics import Forecasts, beside_truth, constant_positions
from training.studies.benchmark_case import BenchmarkCase, FixedScenes

LEGEND = """Each cell gives the mean error on 500 test scenes in pixels of 128 x 128 frames,
followed by half the spread over seeds if there are several; in parentheses the error of the angular
velocity in rad/s; in square brackets the mean negative log likelihood in nats if the network
predicts covariances, which the paper calls perplexity and prints as its natural logarithm; and
after the slash the paper's error and, in square brackets, its likelihood. Budgets differ: the last
columns give the training sequences of each scenario, the optimiser steps, the number of trainings,
and whether the validation error had stopped falling. The paper's networks were trained on about 17
million sequences. Rows named "compact-" have the paper's heads and supervision, but not its VGG16;
rows of one table with the same supervision share the encoder, the state and the angular velocity,
so that their errors of the angular velocity are one figure. Rows with a version ("posnet@1") are
the committed models, which were trained with more supervision than the paper's and, with one ball,
up to T = 40. Balls have a radius of 0.225 m, one of the paper's two. The page
[what we reproduced](../reproduced.md#differences-from-the-paper) lists what else differs from the
paper."""
"""Caption shared by the tables of methods."""
IMPACTS = """Two balls that collide separate with 0.7 of their speed of approach; the paper's, of
restitution 0.7 each, with 0.49."""
"""Sentence of the tables with several balls."""
BUDGET = 60_000
"""Training sequences of each kind of scene for every row that learns, if there is time for them."""
STATE_BUDGET = 2_000_000
"""Training sequences of rows from true states, which need no rendering."""
VALIDATION_SCENES = 100
PLAIN = " without angular velocity"
"""Suffix of methods without angular velocity as input and output."""
MIDDLE = "middle of the frame"
COMPACT = "compact-"
"""Prefix of the studies' networks, unlike the paper's and the committed models."""
POSITIONS = "positions of frames"
POSITIONS_AND_SPINS = "positions, angular velocities of frames"
"""The paper's supervision."""


@dataclass(frozen=True)
class StudyBudget:
    """Budget of a study.

    Attributes
    ----------
    workers
        Processes that simulate.
    sequences
        Training sequences of each kind of scene for every row that learns; None for BUDGET, and
        STATE_BUDGET for rows from states.
    seeds
        Trainings of every row that learns, which differ in their random numbers.
    seed
        The training that is meant, from 1 on.
    """

    workers: int = 1
    sequences: int | None = None
    seeds: int = 1
    seed: int = 1

    def of(self, usual: int) -> int:
        """Return the training sequences of a row whose usual budget is ``usual``."""
        return usual if self.sequences is None else self.sequences

    def suffix(self, usual: int) -> str:
        """Tells the folders of other budgets and seeds apart."""
        length = "" if self.of(usual) == BUDGET else f"-{self.of(usual)}"
        return length + ("" if self.seed == 1 else f"-seed-{self.seed}")


def paper_method(method: str) -> str:
    """Return a method's name in ``paper.json``."""
    return method.removeprefix(COMPACT)


class RowResult(NamedTuple):
    """Forecasts of a row, and the training that they came from.

    Attributes
    ----------
    optimiser_steps
        Steps of the training; None for methods that the study does not train.
    converged
        Whether the validation error hardly fell over its last fifth.
    """

    forecasts: Forecasts
    optimiser_steps: int | None = None
    converged: bool | None = None


@dataclass(frozen=True)
class Row:
    """A method of a table.

    Attributes
    ----------
    method
        Its name.
    measure
        Trains it if need be and forecasts test scenes up to T_gen.
    architecture
        Architecture in words.
    supervision
        Supervision of its training; "-" for methods without training.
    learns
        Whether the study trains it.
    given_states
        Whether it is given true states or positions instead of frames.
    fits
        Whether it is made for a case.
    usual_budget
        Training sequences of each kind of scene, if the study's budget says nothing else.
    sequences
        Number of training sequences of a method that is already trained.
    """

    method: str
    measure: Callable[[FixedScenes, StudyBudget], RowResult]
    architecture: str
    supervision: str
    learns: bool
    given_states: bool
    fits: Callable[[BenchmarkCase], bool] = lambda _: True
    usual_budget: int = BUDGET
    sequences: int | None = None

    @property
    def paper_method(self) -> str:
        """Its name in ``paper.json``."""
        return paper_method(self.method)

    def trained_on(self, budget: StudyBudget) -> int | None:
        """Return its number of training sequences; None for methods without training."""
        return budget.of(self.usual_budget) if self.learns else self.sequences


def constant_position() -> Row:
    """Every ball stays where it is at t = 0."""

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:  # noqa: ARG001
        truth = np.stack([window.positions for window in test.truth])
        return RowResult(beside_truth(test.truth, constant_positions(truth), None, None))

    return Row(
        "constant position", measure, "true position of t = 0", "-", learns=False, given_states=True
    )


def middle_of_frame() -> Row:
    """Row whose forecasts are the middle of the frame, the error of an untrained network."""

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:  # noqa: ARG001
        positions = np.stack([window.positions for window in test.truth])
        middle = np.full_like(positions, NETWORK_FRAME_SIZE / 2)
        return RowResult(beside_truth(test.truth, middle, None, None))

    return Row(MIDDLE, measure, "-", "-", learns=False, given_states=True)


def least_squares(method: str, degree: int) -> Row:
    """Linear or Quadratic."""

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:  # noqa: ARG001
        horizon = test.case.horizon
        positions = polynomial(test.seen_positions(POINTS), degree, horizon)
        spins = polynomial(test.first_spins(), degree, horizon)
        return RowResult(beside_truth(test.truth, positions, None, spins))

    architecture = f"least squares through {POINTS} true positions"
    return Row(method, measure, architecture, "-", learns=False, given_states=True)


def oracle(noise_px: float | None) -> Row:
    """Return the simulator, restarted from the truth or from four positions with noise."""

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:  # noqa: ARG001
        simulator = Oracle()
        horizon = test.case.horizon
        positions: list[np.ndarray] = []
        spins: list[np.ndarray] = []
        seen = test.seen_positions(OBSERVED_FRAMES)
        for recording, exact in zip(test.recordings, seen, strict=True):
            scene = recording.scene
            if noise_px is None:
                path = simulator.from_truth(scene, test.start, horizon)
            else:
                noise = np.random.default_rng(scene.seed).normal(0, noise_px, exact.shape)
                path = simulator.from_positions(scene, exact + noise, horizon)
            positions.append(path.positions)
            spins.append(path.angular_velocities)
        simulator.close()
        return RowResult(beside_truth(test.truth, np.stack(positions), None, np.stack(spins)))

    method = "simulator" if noise_px is None else f"simulator, {noise_px} px"
    return Row(method, measure, "PyBullet", "-", learns=False, given_states=True)


def folder(case: BenchmarkCase, row: str, suffix: str) -> Path:
    """Where a row that learns keeps its checkpoint and its best weights."""
    return runs_folder() / "studies" / case.name / (row.replace(" ", "-") + suffix)
