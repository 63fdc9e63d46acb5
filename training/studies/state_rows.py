"""Rows that are trained on true states: NPE and IFS, in large batches and with cosine schedules.

The publications train for a million steps and more of small batches, with schedules made for that
length. Large batches come as far in a small part of the time, and a cosine ends wherever the
budget does (decision 0138).
"""

from collections.abc import Callable
from functools import partial

import torch

from rollcast.trajectory import FIRST_FORECAST_FRAME
from training.baselines.fitting import FitConfig, fit
from training.baselines.ifs import FRAMES, Ifs
from training.baselines.learner import Learner
from training.baselines.npe import GIVEN, Npe
from training.baselines.states import States, StateSet
from training.objectives.metrics import Forecasts, beside_truth
from training.objectives.schedules import Cosine
from training.studies.benchmark_case import BenchmarkCase, FixedScenes
from training.studies.rows import (
    PLAIN,
    STATE_BUDGET,
    VALIDATION_SCENES,
    Row,
    RowResult,
    StudyBudget,
    folder,
)

NPE_BATCH, NPE_RATE = 1_000, 3e-3
IFS_BATCH, IFS_RATE = 128, 2e-3
LARGE = "-large-batches"
"""Suffix of folder names; folders without it have trainings with the published batches."""

Configure = Callable[[BenchmarkCase, StateSet, int, int], FitConfig[States]]
"""Factory of the training of a case from its scenes, the budget in sequences and the seed."""


def npe(*, angular_velocity: bool) -> Row:
    """NPE. A sequence is taken apart into as many samples as it has steps to predict."""

    def configure(
        case: BenchmarkCase, scenes: StateSet, sequences: int, seed: int
    ) -> FitConfig[States]:
        frames = FIRST_FORECAST_FRAME + case.trained_horizon
        # Samples begin wherever a step of a training window can.
        latest = case.data.latest_start + frames - GIVEN - 1
        return FitConfig(
            max(1, sequences * (frames - GIVEN) // NPE_BATCH),
            partial(scenes.drawn, GIVEN + 1, latest, NPE_BATCH, seed),
            lambda parameters: torch.optim.Adam(parameters, NPE_RATE, fused=True),
            Cosine,
            NPE_BATCH,
            seed,
        )

    def build() -> Learner[States]:
        return Npe(angular_velocity=angular_velocity)

    architecture = "NPE, pairwise perceptrons on two states"
    return _from_states("npe", architecture, build, configure, angular_velocity=angular_velocity)


def ifs(*, angular_velocity: bool) -> Row:
    """IFS."""

    def configure(
        case: BenchmarkCase, scenes: StateSet, sequences: int, seed: int
    ) -> FitConfig[States]:
        return FitConfig(
            max(1, sequences // IFS_BATCH),
            partial(scenes.drawn, FRAMES, case.data.latest_start, IFS_BATCH, seed),
            lambda parameters: torch.optim.Adam(parameters, IFS_RATE, fused=True),
            Cosine,
            IFS_BATCH,
            seed,
        )

    def build() -> Learner[States]:
        return Ifs(angular_velocity=angular_velocity)

    architecture = "interaction network on four states"
    return _from_states("ifs", architecture, build, configure, angular_velocity=angular_velocity)


def _from_states(
    name: str,
    architecture: str,
    build: Callable[[], Learner[States]],
    configure: Configure,
    *,
    angular_velocity: bool,
) -> Row:
    method = name + ("" if angular_velocity else PLAIN)

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:
        case = test.case.usual
        training = StateSet(case.recordings("training", case.data.scenes, budget.workers))
        known = FixedScenes(case, "validation", VALIDATION_SCENES, budget.workers)

        def validate(learner: Learner[States]) -> float:
            errors = _forecasts(learner, known.states, known).errors_px()
            return float(errors[:, :, case.trained_horizon - 1].mean())

        config = configure(case, training, budget.of(STATE_BUDGET), budget.seed)
        home = folder(case, method, LARGE + budget.suffix(STATE_BUDGET))
        fitted = fit(build, config, home, validate)
        with torch.inference_mode():
            made = _forecasts(fitted.learner, test.states, test)
        return RowResult(made, config.batches, fitted.converged)

    supervision = "true positions, angular velocities" if angular_velocity else "true positions"
    return Row(
        method,
        measure,
        architecture,
        supervision,
        learns=True,
        given_states=True,
        usual_budget=STATE_BUDGET,
    )


def _forecasts(learner: Learner[States], given: States, scenes: FixedScenes) -> Forecasts:
    positions, spins = learner.forecast(given, scenes.case.horizon).arrays()
    return beside_truth(scenes.truth, positions, None, spins)
