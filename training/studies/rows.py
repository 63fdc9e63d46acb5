"""How each method of the tables comes to its forecasts: fitted, trained, or simulated."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.baselines.fitting import FitConfig, fit
from training.baselines.ifs import FRAMES, Ifs
from training.baselines.learner import Learner, joined
from training.baselines.least_squares import POINTS, polynomial
from training.baselines.npe import GIVEN, Npe
from training.baselines.oracle import Oracle
from training.baselines.states import States, StateSet
from training.baselines.vin import Vin
from training.baselines.vlstm import VLstm
from training.common.settings import runs_folder
from training.data.scene_cache import load_scene_cache
from training.data.shards import load_recordings, simulate_split
from training.data.windows import Batch, TrainingStream, collate
from training.engine.trainer import BEST, Trainer, TrainerConfig
from training.export.load import load_exported
from training.networks.recurrent import Family, Network
from training.objectives.metrics import Forecasts, beside_truth, forecast, stays_put
from training.objectives.schedules import Cosine, Exponential, Plateau
from training.recipes.recipe import Recipe
from training.studies.benchmark_case import BenchmarkCase, FixedScenes

BUDGET = 60_000
"""Training sequences of each kind of scene for every row that learns, if there is time for them."""
VALIDATION_SCENES = 100
PLAIN = " without angular velocity"
"""What the paper adds to the name of a method that neither sees nor predicts it."""
NPE_BATCH, NPE_DECAY, NPE_DECAY_BATCHES = 50, 0.99, 2500
IFS_BATCH = VIN_BATCH = 4
LSTM_BATCH = 50


@dataclass(frozen=True)
class StudyBudget:
    """What a study may cost.

    Attributes
    ----------
    workers
        Processes that simulate.
    sequences
        Training sequences of each kind of scene for every row that learns.
    """

    workers: int = 1
    sequences: int = BUDGET

    @property
    def suffix(self) -> str:
        """Tells the folders of trainings of other lengths than the tables' apart."""
        return "" if self.sequences == BUDGET else f"-{self.sequences}"


@dataclass(frozen=True)
class Row:
    """A method of a table.

    Attributes
    ----------
    method
        Its name, as in ``paper.json`` where the paper has it.
    forecasts
        Trains it if need be and forecasts test scenes up to T_gen.
    learns
        Whether the study trains it.
    given_states
        Whether it is given true states or positions instead of frames.
    fits
        Whether it is made for a case.
    sequences
        Training sequences of what comes trained.
    """

    method: str
    forecasts: Callable[[FixedScenes, StudyBudget], Forecasts]
    learns: bool
    given_states: bool
    fits: Callable[[BenchmarkCase], bool] = lambda _: True
    sequences: int | None = None

    def trained_on(self, budget: StudyBudget) -> int | None:
        """Return its training sequences; None for what learns nothing."""
        return budget.sequences if self.learns else self.sequences


def resting() -> Row:
    """Stays put."""

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:  # noqa: ARG001
        truth = np.stack([window.positions for window in test.truth])
        return beside_truth(test.truth, stays_put(truth), None, None)

    return Row("stays put", forecasts, learns=False, given_states=True)


def least_squares(method: str, degree: int) -> Row:
    """Linear or Quadratic."""

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:  # noqa: ARG001
        horizon = test.case.horizon
        positions = polynomial(test.seen_positions(POINTS), degree, horizon)
        spins = polynomial(test.first_spins(), degree, horizon)
        return beside_truth(test.truth, positions, None, spins)

    return Row(method, forecasts, learns=False, given_states=True)


def oracle(noise_px: float | None) -> Row:
    """Return the simulator, restarted from the truth or from four positions with noise."""

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:  # noqa: ARG001
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
        return beside_truth(test.truth, np.stack(positions), None, np.stack(spins))

    method = "simulator" if noise_px is None else f"simulator, {noise_px} px"
    return Row(method, forecasts, learns=False, given_states=True)


def npe(*, angular_velocity: bool) -> Row:
    """NPE, trained as published: RMSProp at 3e-4, 0.99 of it after every 2,500 batches of 50.

    A sequence is taken apart into as many samples as it has steps to predict.
    """

    def fit_config(case: BenchmarkCase, scenes: StateSet, budget: int) -> FitConfig[States]:
        frames = FIRST_FORECAST_FRAME + case.trained_horizon
        batches = budget * (frames - GIVEN) // NPE_BATCH
        # Samples begin wherever a step of a training window can.
        latest = case.data.latest_start + frames - GIVEN - 1
        return FitConfig(
            batches,
            partial(scenes.drawn, GIVEN + 1, latest, NPE_BATCH, 1),
            lambda parameters: torch.optim.RMSprop(parameters, 3e-4, alpha=0.99),
            lambda: Exponential(NPE_DECAY ** (batches / NPE_DECAY_BATCHES)),
            NPE_BATCH,
        )

    build = partial(Npe, angular_velocity=angular_velocity)
    return _from_states("npe" + ("" if angular_velocity else PLAIN), build, fit_config)


def ifs(*, angular_velocity: bool) -> Row:
    """IFS, trained as VIN is: Adam at 5e-4, batches of 4; the paper's rule lowers it."""

    def fit_config(case: BenchmarkCase, scenes: StateSet, budget: int) -> FitConfig[States]:
        return FitConfig(
            budget // IFS_BATCH,
            partial(scenes.drawn, FRAMES, case.data.latest_start, IFS_BATCH, 1),
            lambda parameters: torch.optim.Adam(parameters, 5e-4),
            Plateau,
            IFS_BATCH,
        )

    build = partial(Ifs, angular_velocity=angular_velocity)
    return _from_states("ifs" + ("" if angular_velocity else PLAIN), build, fit_config)


def _from_states(
    method: str,
    build: Callable[[], Learner[States]],
    fit_config: Callable[[BenchmarkCase, StateSet, int], FitConfig[States]],
) -> Row:
    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:
        case = test.case.usual
        training = StateSet(case.recordings("training", case.data.scenes, budget.workers))
        known = FixedScenes(case, "validation", VALIDATION_SCENES, budget.workers)

        def validate(learner: Learner[States]) -> float:
            made = _forecasts(learner, known.states, known)
            return float(made.errors_px()[:, :, case.trained_horizon - 1].mean())

        chosen = fit_config(case, training, budget.sequences)
        learner = fit(build, chosen, folder(case, method, budget), validate)
        with torch.inference_mode():
            return _forecasts(learner, test.states, test)

    return Row(method, forecasts, learns=True, given_states=True)


def vin() -> Row:
    """VIN: Adam at 5e-4, batches of 4; that the rate decays to a tenth is our choice."""

    def fit_config(stream: Callable[[int], Iterator[Batch]], budget: int) -> FitConfig[Batch]:
        return FitConfig(
            budget // VIN_BATCH,
            stream,
            lambda parameters: torch.optim.Adam(parameters, 5e-4),
            lambda: Exponential(0.1),
            VIN_BATCH,
        )

    def build(case: BenchmarkCase) -> Learner[Batch]:
        return Vin(case.objects, case.trained_horizon)

    return _from_frames("vin" + PLAIN, build, fit_config, VIN_BATCH)


def v_lstm(*, angular_velocity: bool) -> Row:
    """V-LSTM in batches of 50, as the paper's own networks.

    Adam at 3e-4 and a cosine take the place of RMSProp at 1e-4 and plateaus, which are made for
    two thousand epochs and not for the seven that there are.
    """

    def fit_config(stream: Callable[[int], Iterator[Batch]], budget: int) -> FitConfig[Batch]:
        return FitConfig(
            budget // LSTM_BATCH,
            stream,
            lambda parameters: torch.optim.Adam(parameters, 3e-4),
            Cosine,
            LSTM_BATCH,
        )

    def build(case: BenchmarkCase) -> Learner[Batch]:
        return VLstm(case.objects, case.trained_horizon, angular_velocity=angular_velocity)

    method = "v-lstm" + ("" if angular_velocity else PLAIN)
    return _from_frames(method, build, fit_config, LSTM_BATCH)


def _from_frames(
    method: str,
    build: Callable[[BenchmarkCase], Learner[Batch]],
    fit_config: Callable[[Callable[[int], Iterator[Batch]], int], FitConfig[Batch]],
    batch_size: int,
) -> Row:
    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:
        case = test.case.usual
        shards = simulate_split(case.source, "training", case.data.scenes, budget.workers)

        def stream(first: int) -> Iterator[Batch]:
            drawn = TrainingStream(
                [load_recordings(shards)],
                [1.0],
                [case.data.latest_start],
                None,
                batch_size,
                seed=1,
                first_batch=first,
                scene_caches=[load_scene_cache(shards, budget.workers)],
            )
            return iter(DataLoader(drawn, batch_size=None, num_workers=1, prefetch_factor=4))

        known = FixedScenes(case, "validation", VALIDATION_SCENES, budget.workers)

        def validate(learner: Learner[Batch]) -> float:
            made = _seen(learner, known)
            return float(made.errors_px()[:, :, case.trained_horizon - 1].mean())

        chosen = fit_config(stream, budget.sequences)
        learner = fit(partial(build, case), chosen, folder(case, method, budget), validate)
        with torch.inference_mode():
            return _seen(learner, test)

    return Row(method, forecasts, learns=True, given_states=False)


def _seen(learner: Learner[Batch], scenes: FixedScenes) -> Forecasts:
    windows, horizon = scenes.windows, scenes.case.horizon
    batches = (collate(windows[k : k + LSTM_BATCH]) for k in range(0, len(windows), LSTM_BATCH))
    made = joined([learner.forecast(batch, horizon) for batch in batches])
    positions, spins = made.arrays()
    return beside_truth(windows, positions, None, spins)


def _forecasts(learner: Learner[States], given: States, scenes: FixedScenes) -> Forecasts:
    positions, spins = learner.forecast(given, scenes.case.horizon).arrays()
    return beside_truth(scenes.truth, positions, None, spins)


def ours(recipe: Recipe, member: str, method: str) -> Row:
    """Return a network of ours, trained from nothing within the tables' budget.

    Its whole family is trained at once, in one training for all scenarios, and serves its other
    members' rows too.

    Parameters
    ----------
    recipe
        Of one kind of scene a scenario.
    """

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:
        network = _trained(recipe, member, budget)
        return _seeing(network, test, recipe.task.final_step)

    def fits(case: BenchmarkCase) -> bool:
        seen = {share.source.override for share in recipe.data}
        return case.objects == recipe.task.objects and case.override in seen

    return Row(method, forecasts, learns=True, given_states=False, fits=fits)


def ours_trained_to_each(recipes: Mapping[int, Recipe], member: str, method: str) -> Row:
    """Return networks of ours of which each forecasts only as far as it was trained.

    Parameters
    ----------
    recipes
        By T, the last step of their training.
    """

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:
        made = {
            steps: _seeing(_trained(recipe, member, budget), test)
            for steps, recipe in recipes.items()
        }
        whole = made[max(made)]
        begin = 0
        for steps in sorted(made):
            for name in ("positions", "angular_velocities"):
                getattr(whole, name)[:, :, begin:steps] = getattr(made[steps], name)[
                    :, :, begin:steps
                ]
            begin = steps
        return whole

    return Row(method, forecasts, learns=True, given_states=False)


def _trained(recipe: Recipe, member: str, budget: StudyBudget) -> Network:
    whole = replace(recipe, sequences=budget.sequences * len(recipe.data))
    folder = runs_folder() / "studies" / (whole.name + budget.suffix)
    Trainer(whole, folder, TrainerConfig(simulators=budget.workers)).run()
    network = whole.build().networks()[member]
    best = torch.load(folder / BEST, map_location="cpu", weights_only=True)
    network.load_state_dict(best["weights"][member])
    return network


def shipped(folder: Path) -> Row:
    """Return a committed model, with the budget that it has had."""
    manifest, network = load_exported(folder)
    sequences = manifest.training["sequences"]
    assert isinstance(sequences, int)

    def forecasts(test: FixedScenes, budget: StudyBudget) -> Forecasts:  # noqa: ARG001
        return _seeing(network, test, manifest.final_step)

    def fits(case: BenchmarkCase) -> bool:
        return case.objects == manifest.objects

    return Row(
        manifest.label, forecasts, learns=False, given_states=False, fits=fits, sequences=sequences
    )


def _seeing(network: Network, test: FixedScenes, final_step: int | None = None) -> Forecasts:
    alone = Family({"it": network})
    windows, horizon = test.windows, test.case.horizon
    if final_step is not None:
        windows, horizon = test.windows_until(final_step), final_step + 1
    return forecast(alone, windows, horizon, torch.device("cpu"))["it"]


def folder(case: BenchmarkCase, method: str, budget: StudyBudget) -> Path:
    """Where a row that learns keeps its checkpoint and its best weights."""
    return runs_folder() / "studies" / case.name / (method.replace(" ", "-") + budget.suffix)
