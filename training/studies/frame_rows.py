"""Rows of other people's networks that are trained on frames: VIN and V-LSTM."""

from collections.abc import Callable, Iterator
from functools import partial

import torch
from torch.utils.data import DataLoader

from training.baselines.fitting import FitConfig, fit
from training.baselines.learner import Learner, joined
from training.baselines.vin import Vin
from training.baselines.vlstm import VLstm
from training.data.scene_cache import load_scene_cache
from training.data.shards import load_recordings, simulate_split
from training.data.windows import Batch, TrainingStream, collate
from training.objectives.metrics import Forecasts, beside_truth
from training.objectives.schedules import Cosine
from training.studies.benchmark_case import BenchmarkCase, FixedScenes
from training.studies.rows import (
    BUDGET,
    PLAIN,
    POSITIONS,
    POSITIONS_AND_SPINS,
    VALIDATION_SCENES,
    Row,
    RowResult,
    StudyBudget,
    folder,
)

VIN_BATCH = 32
LSTM_BATCH = 50

Configure = Callable[[Callable[[int], Iterator[Batch]], int, int], FitConfig[Batch]]
"""Factory of a training from its stream of batches, the budget in sequences and the seed."""


def vin() -> Row:
    """VIN: Adam at 5e-4 down a cosine, in batches of 32."""

    def configure(
        stream: Callable[[int], Iterator[Batch]], sequences: int, seed: int
    ) -> FitConfig[Batch]:
        return FitConfig(
            max(1, sequences // VIN_BATCH),
            stream,
            lambda parameters: torch.optim.Adam(parameters, 5e-4),
            Cosine,
            VIN_BATCH,
            seed,
        )

    def build(case: BenchmarkCase) -> Learner[Batch]:
        return Vin(case.objects, case.trained_horizon)

    return _from_frames(
        "vin" + PLAIN, "convolutions, interaction network", POSITIONS, build, configure, VIN_BATCH
    )


def v_lstm(*, angular_velocity: bool) -> Row:
    """V-LSTM in batches of 50, as the paper's own networks, without ImageNet's weights.

    Adam at 3e-4 and a cosine take the place of RMSProp at 1e-4 and plateaus, which are made for
    two thousand epochs.
    """

    def configure(
        stream: Callable[[int], Iterator[Batch]], sequences: int, seed: int
    ) -> FitConfig[Batch]:
        return FitConfig(
            max(1, sequences // LSTM_BATCH),
            stream,
            lambda parameters: torch.optim.Adam(parameters, 3e-4),
            Cosine,
            LSTM_BATCH,
            seed,
            bfloat16=True,
        )

    def build(case: BenchmarkCase) -> Learner[Batch]:
        return VLstm(case.objects, case.trained_horizon, angular_velocity=angular_velocity)

    method = "v-lstm" + ("" if angular_velocity else PLAIN)
    supervision = POSITIONS_AND_SPINS if angular_velocity else POSITIONS
    return _from_frames(
        method, "AlexNet from random weights, LSTM", supervision, build, configure, LSTM_BATCH
    )


def _from_frames(
    method: str,
    architecture: str,
    supervision: str,
    build: Callable[[BenchmarkCase], Learner[Batch]],
    configure: Configure,
    batch_size: int,
) -> Row:
    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:
        case = test.case.usual
        shards = simulate_split(case.source, "training", case.data.scenes, budget.workers)

        def stream(first: int) -> Iterator[Batch]:
            drawn = TrainingStream(
                [load_recordings(shards)],
                [1.0],
                [case.data.latest_start],
                None,
                batch_size,
                seed=budget.seed,
                first_batch=first,
                scene_caches=[load_scene_cache(shards, budget.workers)],
            )
            return iter(DataLoader(drawn, batch_size=None, num_workers=1, prefetch_factor=4))

        known = FixedScenes(case, "validation", VALIDATION_SCENES, budget.workers)

        def validate(learner: Learner[Batch]) -> float:
            errors = _seen(learner, known).errors_px()
            return float(errors[:, :, case.trained_horizon - 1].mean())

        config = configure(stream, budget.of(BUDGET), budget.seed)
        home = folder(case, method, f"-batches-of-{batch_size}{budget.suffix(BUDGET)}")
        fitted = fit(partial(build, case), config, home, validate)
        with torch.inference_mode():
            made = _seen(fitted.learner, test)
        return RowResult(made, config.batches, fitted.converged)

    return Row(method, measure, architecture, supervision, learns=True, given_states=False)


def _seen(learner: Learner[Batch], scenes: FixedScenes) -> Forecasts:
    windows, horizon = scenes.windows, scenes.case.horizon
    batches = (collate(windows[k : k + LSTM_BATCH]) for k in range(0, len(windows), LSTM_BATCH))
    made = joined([learner.forecast(batch, horizon) for batch in batches])
    positions, spins = made.arrays()
    return beside_truth(windows, positions, None, spins)
