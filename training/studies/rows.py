"""How each method of the tables comes to its forecasts: fitted, trained, or simulated."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.baselines.fitting import Course, fit
from training.baselines.ifs import FRAMES, Ifs
from training.baselines.learner import Learner, joined
from training.baselines.least_squares import POINTS, polynomial
from training.baselines.npe import GIVEN, Npe
from training.baselines.oracle import Oracle
from training.baselines.states import States, StateSet
from training.baselines.vin import Vin
from training.baselines.vlstm import VLstm
from training.common.settings import runs_folder
from training.data.scene_cache import survey
from training.data.shards import load_recordings, simulate_split
from training.data.windows import Batch, TrainingStream, collate
from training.engine.trainer import BEST, Pace, Trainer
from training.export.load import load_exported
from training.networks.recurrent import Family, Network
from training.objectives.metrics import Forecasts, beside_truth, forecast, stays_put
from training.objectives.schedules import Cosine, Exponential, Plateau
from training.recipes.recipe import Recipe
from training.studies.subject import FixedScenes, Subject

BUDGET = 60_000
"""Training sequences of each kind of scene for every row that learns, if there is time for them."""
VALIDATION_SCENES = 100
PLAIN = " without angular velocity"
"""What the paper adds to the name of a method that neither sees nor predicts it."""
NPE_BATCH, NPE_DECAY, NPE_DECAY_BATCHES = 50, 0.99, 2500
IFS_BATCH = VIN_BATCH = 4
LSTM_BATCH = 50


@dataclass(frozen=True)
class Effort:
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
        Whether it is made for a subject.
    sequences
        Training sequences of what comes trained.
    """

    method: str
    forecasts: Callable[[FixedScenes, Effort], Forecasts]
    learns: bool
    given_states: bool
    fits: Callable[[Subject], bool] = lambda _: True
    sequences: int | None = None

    def trained_on(self, effort: Effort) -> int | None:
        """Return its training sequences; None for what learns nothing."""
        return effort.sequences if self.learns else self.sequences


def resting() -> Row:
    """Stays put."""

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:  # noqa: ARG001
        truth = np.stack([window.positions for window in test.truth])
        return beside_truth(test.truth, stays_put(truth), None, None)

    return Row("stays put", forecasts, learns=False, given_states=True)


def least_squares(method: str, degree: int) -> Row:
    """Linear or Quadratic."""

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:  # noqa: ARG001
        horizon = test.subject.horizon
        positions = polynomial(test.seen_positions(POINTS), degree, horizon)
        spins = polynomial(test.first_spins(), degree, horizon)
        return beside_truth(test.truth, positions, None, spins)

    return Row(method, forecasts, learns=False, given_states=True)


def oracle(noise_px: float | None) -> Row:
    """Return the simulator, restarted from the truth or from four positions with noise."""

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:  # noqa: ARG001
        simulator = Oracle()
        horizon = test.subject.horizon
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

    def course(subject: Subject, scenes: StateSet, budget: int) -> Course[States]:
        frames = FIRST_FORECAST_FRAME + subject.trained_horizon
        batches = budget * (frames - GIVEN) // NPE_BATCH
        # Samples begin wherever a step of a training window can.
        latest = subject.data.latest_start + frames - GIVEN - 1
        return Course(
            batches,
            partial(scenes.drawn, GIVEN + 1, latest, NPE_BATCH, 1),
            lambda parameters: torch.optim.RMSprop(parameters, 3e-4, alpha=0.99),
            lambda: Exponential(NPE_DECAY ** (batches / NPE_DECAY_BATCHES)),
            NPE_BATCH,
        )

    build = partial(Npe, angular_velocity=angular_velocity)
    return _from_states("npe" + ("" if angular_velocity else PLAIN), build, course)


def ifs(*, angular_velocity: bool) -> Row:
    """IFS, trained as VIN is: Adam at 5e-4, batches of 4; the paper's rule lowers it."""

    def course(subject: Subject, scenes: StateSet, budget: int) -> Course[States]:
        return Course(
            budget // IFS_BATCH,
            partial(scenes.drawn, FRAMES, subject.data.latest_start, IFS_BATCH, 1),
            lambda parameters: torch.optim.Adam(parameters, 5e-4),
            Plateau,
            IFS_BATCH,
        )

    build = partial(Ifs, angular_velocity=angular_velocity)
    return _from_states("ifs" + ("" if angular_velocity else PLAIN), build, course)


def _from_states(
    method: str,
    build: Callable[[], Learner[States]],
    course: Callable[[Subject, StateSet, int], Course[States]],
) -> Row:
    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:
        subject = test.subject.usual
        training = StateSet(subject.recordings("training", subject.data.scenes, effort.workers))
        known = FixedScenes(subject, "validation", VALIDATION_SCENES, effort.workers)

        def validate(learner: Learner[States]) -> float:
            made = _forecasts(learner, known.states, known)
            return float(made.errors_px()[:, :, subject.trained_horizon - 1].mean())

        chosen = course(subject, training, effort.sequences)
        learner = fit(build, chosen, folder(subject, method, effort), validate)
        with torch.inference_mode():
            return _forecasts(learner, test.states, test)

    return Row(method, forecasts, learns=True, given_states=True)


def vin() -> Row:
    """VIN: Adam at 5e-4, batches of 4; that the rate decays to a tenth is our choice."""

    def course(stream: Callable[[int], Iterator[Batch]], budget: int) -> Course[Batch]:
        return Course(
            budget // VIN_BATCH,
            stream,
            lambda parameters: torch.optim.Adam(parameters, 5e-4),
            lambda: Exponential(0.1),
            VIN_BATCH,
        )

    def build(subject: Subject) -> Learner[Batch]:
        return Vin(subject.objects, subject.trained_horizon)

    return _from_frames("vin" + PLAIN, build, course, VIN_BATCH)


def v_lstm(*, angular_velocity: bool) -> Row:
    """V-LSTM in batches of 50, as the paper's own networks.

    Adam at 3e-4 and a cosine take the place of RMSProp at 1e-4 and plateaus, which are made for
    two thousand epochs and not for the seven that there are.
    """

    def course(stream: Callable[[int], Iterator[Batch]], budget: int) -> Course[Batch]:
        return Course(
            budget // LSTM_BATCH,
            stream,
            lambda parameters: torch.optim.Adam(parameters, 3e-4),
            Cosine,
            LSTM_BATCH,
        )

    def build(subject: Subject) -> Learner[Batch]:
        return VLstm(subject.objects, subject.trained_horizon, angular_velocity=angular_velocity)

    method = "v-lstm" + ("" if angular_velocity else PLAIN)
    return _from_frames(method, build, course, LSTM_BATCH)


def _from_frames(
    method: str,
    build: Callable[[Subject], Learner[Batch]],
    course: Callable[[Callable[[int], Iterator[Batch]], int], Course[Batch]],
    batch_size: int,
) -> Row:
    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:
        subject = test.subject.usual
        shards = simulate_split(subject.source, "training", subject.data.scenes, effort.workers)

        def stream(first: int) -> Iterator[Batch]:
            drawn = TrainingStream(
                [load_recordings(shards)],
                [1.0],
                [subject.data.latest_start],
                None,
                batch_size,
                seed=1,
                first_batch=first,
                surveys=[survey(shards, effort.workers)],
            )
            return iter(DataLoader(drawn, batch_size=None, num_workers=1, prefetch_factor=4))

        known = FixedScenes(subject, "validation", VALIDATION_SCENES, effort.workers)

        def validate(learner: Learner[Batch]) -> float:
            made = _seen(learner, known)
            return float(made.errors_px()[:, :, subject.trained_horizon - 1].mean())

        chosen = course(stream, effort.sequences)
        learner = fit(partial(build, subject), chosen, folder(subject, method, effort), validate)
        with torch.inference_mode():
            return _seen(learner, test)

    return Row(method, forecasts, learns=True, given_states=False)


def _seen(learner: Learner[Batch], scenes: FixedScenes) -> Forecasts:
    windows, horizon = scenes.windows, scenes.subject.horizon
    batches = (collate(windows[k : k + LSTM_BATCH]) for k in range(0, len(windows), LSTM_BATCH))
    made = joined([learner.forecast(batch, horizon) for batch in batches])
    positions, spins = made.arrays()
    return beside_truth(windows, positions, None, spins)


def _forecasts(learner: Learner[States], given: States, scenes: FixedScenes) -> Forecasts:
    positions, spins = learner.forecast(given, scenes.subject.horizon).arrays()
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

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:
        network = _trained(recipe, member, effort)
        return _seeing(network, test, recipe.task.final_step)

    def fits(subject: Subject) -> bool:
        seen = {share.source.change for share in recipe.data}
        return subject.objects == recipe.task.objects and subject.change in seen

    return Row(method, forecasts, learns=True, given_states=False, fits=fits)


def ours_trained_to_each(recipes: Mapping[int, Recipe], member: str, method: str) -> Row:
    """Return networks of ours of which each forecasts only as far as it was trained.

    Parameters
    ----------
    recipes
        By T, the last step of their training.
    """

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:
        made = {
            steps: _seeing(_trained(recipe, member, effort), test)
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


def _trained(recipe: Recipe, member: str, effort: Effort) -> Network:
    whole = replace(recipe, sequences=effort.sequences * len(recipe.data))
    folder = runs_folder() / "studies" / (whole.name + effort.suffix)
    Trainer(whole, folder, Pace(simulators=effort.workers)).run()
    network = whole.build().networks()[member]
    best = torch.load(folder / BEST, map_location="cpu", weights_only=True)
    network.load_state_dict(best["weights"][member])
    return network


def shipped(folder: Path) -> Row:
    """Return a committed model, with the budget that it has had."""
    manifest, network = load_exported(folder)
    sequences = manifest.training["sequences"]
    assert isinstance(sequences, int)

    def forecasts(test: FixedScenes, effort: Effort) -> Forecasts:  # noqa: ARG001
        return _seeing(network, test, manifest.final_step)

    def fits(subject: Subject) -> bool:
        return subject.objects == manifest.objects

    return Row(
        manifest.label, forecasts, learns=False, given_states=False, fits=fits, sequences=sequences
    )


def _seeing(network: Network, test: FixedScenes, final_step: int | None = None) -> Forecasts:
    alone = Family({"it": network})
    windows, horizon = test.windows, test.subject.horizon
    if final_step is not None:
        windows, horizon = test.windows_until(final_step), final_step + 1
    return forecast(alone, windows, horizon, torch.device("cpu"))["it"]


def folder(subject: Subject, method: str, effort: Effort) -> Path:
    """Where a row that learns keeps its checkpoint and its best weights."""
    return runs_folder() / "studies" / subject.name / (method.replace(" ", "-") + effort.suffix)
