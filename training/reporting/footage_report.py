"""Forecasts of clips that training never saw, beside the baselines (paper, "Real data").

Figures are of windows of the test clips, in 128-px units: an error at T is that of step T - 1.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from rollcast.markdown import table
from rollcast.trajectory import FIRST_FORECAST_FRAME
from training.baselines.fitting import FitConfig, fit
from training.baselines.ifs import FRAMES, Ifs
from training.baselines.learner import Learner, joined
from training.baselines.least_squares import POINTS, polynomial
from training.baselines.states import HALF_FRAME_PX, States, turned
from training.baselines.vin import Vin
from training.baselines.vlstm import VLstm
from training.common.run_folder import read_best
from training.common.settings import runs_folder
from training.data.clip_dataset import EVERY, Clips, ClipStream, Place
from training.data.splits import Split
from training.data.windows import Batch, Window, collate
from training.evaluation.evaluate import mean_error
from training.export.export import fit_covariance, with_covariance
from training.networks.recurrent import Family
from training.objectives.metrics import Forecasts, beside_truth, constant_positions, forecast
from training.objectives.schedules import Cosine, Exponential, Plateau
from training.recipes.recipe import Recipe
from training.recipes.setup import T_GEN, T_TRAIN

BUDGET = 24_000
"""Training sequences of every baseline that learns."""
BATCH = 4
LSTM_BATCH = 50
TOGETHER = 50
"""Windows that are forecast at once."""


class Measured(NamedTuple):
    """A row of the table."""

    method: str
    balls: str
    errors: Mapping[int, tuple[float, float]]
    """Mean error and its standard error, pixels, by T."""
    inside: Mapping[int, tuple[float, float]] | None
    """Shares of the truths inside the ellipses of 50 and 95 %, by T; None without ellipses."""


class SetupClips:
    """Clips by split, and the evaluation windows shared by all methods.

    Parameters
    ----------
    horizon
        Steps of a window.
    every
        Frames between windows.
    """

    def __init__(
        self, clips: Mapping[Split, Clips], horizon: int = T_GEN, every: int = EVERY
    ) -> None:
        self.clips = clips
        self.horizon = horizon
        self.every = every
        self.objects = clips["training"].objects
        self.places = {
            split: clips[split].places(horizon, every) for split in ("validation", "test")
        }

    @property
    def moments(self) -> tuple[int, ...]:
        """Values of T that are compared."""
        return tuple(t for t in (T_TRAIN, T_GEN) if t <= self.horizon)

    def windows(self, split: Split) -> list[Window]:
        """Return the windows of a split, with frames."""
        return [self.clips[split].window(place, self.horizon) for place in self.places[split]]

    def histories(self, split: Split) -> np.ndarray:
        """Return the first ten positions of every window, as Linear and Quadratic are given."""
        return np.stack([self.clips[split].history(one, POINTS) for one in self.places[split]])

    def states(self, split: Split) -> States:
        """Return every window as states."""
        return _states(self.clips[split], self.places[split], FIRST_FORECAST_FRAME + self.horizon)


def measure(
    setup: SetupClips, baselines: Sequence[str], trained: Sequence[Recipe]
) -> Iterator[Measured]:
    """Measure baselines and trained networks on the test clips, one row after the other.

    Parameters
    ----------
    baselines
        Names from :data:`BASELINES`; trainable ones are trained unless a run exists.
    trained
        Recipes whose runs are there, for as many balls as the setup has.
    """
    for name in baselines:
        yield from rows_of(name, BASELINES[name](setup), setup.moments)
    for recipe in trained:
        yield from rows_of(recipe.name, _network(setup, recipe), setup.moments)


def rows_of(method: str, made: Forecasts, moments: Sequence[int]) -> Iterator[Measured]:
    """Yield the row of all balls and, where there are several, that of the first one."""
    yield _measured(method, "all", made, moments)
    if made.positions.shape[1] > 1:
        yield _measured(method, "first", made.of_balls(slice(1)), moments)


def _measured(method: str, balls: str, made: Forecasts, moments: Sequence[int]) -> Measured:
    errors, inside = made.errors_px(), made.calibration((0.5, 0.95))
    return Measured(
        method,
        balls,
        {t: mean_error(errors[:, :, t - 1]) for t in moments},
        None if inside is None else {t: (inside[0.5][t - 1], inside[0.95][t - 1]) for t in moments},
    )


def _network(setup: SetupClips, recipe: Recipe) -> Forecasts:
    """Forecast with a run's best weights; the ellipses' scale comes from the validation clips."""
    best = read_best(runs_folder() / recipe.name)
    (name, network), *_ = recipe.build().networks().items()
    network.load_state_dict(best["weights"][name])
    family, cpu = Family({"it": network}), torch.device("cpu")
    known, unseen = (
        {"footage": forecast(family, setup.windows(split), setup.horizon, cpu)["it"]}
        for split in ("validation", "test")
    )
    return with_covariance(unseen, fit_covariance(known))["footage"]


def _constant_position(setup: SetupClips) -> Forecasts:
    windows = setup.windows("test")
    truth = np.stack([window.positions for window in windows])
    return beside_truth(windows, constant_positions(truth), None, None)


def _least_squares(degree: int, setup: SetupClips) -> Forecasts:
    positions = polynomial(setup.histories("test"), degree, setup.horizon)
    return beside_truth(setup.windows("test"), positions, None, None)


def _ifs(setup: SetupClips) -> Forecasts:
    fit_config = FitConfig[States](
        BUDGET // BATCH,
        partial(_drawn_states, setup.clips["training"]),
        lambda parameters: torch.optim.Adam(parameters, 5e-4),
        Plateau,
        BATCH,
    )

    def made(learner: Learner[States], split: Split) -> Forecasts:
        positions, _ = learner.forecast(setup.states(split), setup.horizon).arrays()
        return beside_truth(setup.windows(split), positions, None, None)

    return _trained(setup, "ifs", partial(Ifs, angular_velocity=False), fit_config, made)


def _vin(setup: SetupClips) -> Forecasts:
    fit_config = FitConfig[Batch](
        BUDGET // BATCH,
        partial(_drawn_frames, setup.clips["training"], BATCH),
        lambda parameters: torch.optim.Adam(parameters, 5e-4),
        lambda: Exponential(0.1),
        BATCH,
    )
    return _trained(
        setup, "vin", partial(Vin, setup.objects, T_TRAIN), fit_config, partial(_seen, setup)
    )


def _v_lstm(setup: SetupClips) -> Forecasts:
    fit_config = FitConfig[Batch](
        BUDGET // LSTM_BATCH,
        partial(_drawn_frames, setup.clips["training"], LSTM_BATCH),
        lambda parameters: torch.optim.Adam(parameters, 3e-4),
        Cosine,
        LSTM_BATCH,
    )
    build = partial(VLstm, setup.objects, T_TRAIN, angular_velocity=False)
    return _trained(setup, "v-lstm", build, fit_config, partial(_seen, setup))


BASELINES: Mapping[str, Callable[[SetupClips], Forecasts]] = {
    "constant position": _constant_position,
    "linear": partial(_least_squares, 1),
    "quadratic": partial(_least_squares, 2),
    "ifs": _ifs,
    "vin": _vin,
    "v-lstm": _v_lstm,
}


def _trained(
    setup: SetupClips,
    name: str,
    build: Callable[[], Learner],
    fit_config: FitConfig,
    made: Callable[[Learner, Split], Forecasts],
) -> Forecasts:
    def validate(learner: Learner) -> float:
        return float(made(learner, "validation").errors_px()[:, :, T_TRAIN - 1].mean())

    folder = runs_folder() / "setup" / f"{name}-{setup.objects}"
    learner = fit(build, fit_config, folder, validate).learner
    with torch.inference_mode():
        return made(learner, "test")


def _seen(setup: SetupClips, learner: Learner[Batch], split: Split) -> Forecasts:
    windows = setup.windows(split)
    parts = [windows[k : k + TOGETHER] for k in range(0, len(windows), TOGETHER)]
    positions, _ = joined(
        [learner.forecast(collate(part), setup.horizon) for part in parts]
    ).arrays()
    return beside_truth(windows, positions, None, None)


def _drawn_frames(clips: Clips, batch_size: int, first: int) -> Iterator[Batch]:
    return iter(ClipStream(clips, T_TRAIN, batch_size, seed=1, first_batch=first))


def _drawn_states(clips: Clips, first: int) -> Iterator[States]:
    places = clips.places(FRAMES - FIRST_FORECAST_FRAME)
    number = first
    while True:
        generator = np.random.default_rng([1, number])
        drawn = [places[row] for row in generator.integers(len(places), size=BATCH)]
        turns = torch.from_numpy(generator.integers(4, size=BATCH))
        mirrored = torch.from_numpy(generator.integers(2, size=BATCH)).bool()
        yield turned(_states(clips, drawn, FRAMES), turns, mirrored)
        number += 1


def _states(clips: Clips, places: Sequence[Place], frames: int) -> States:
    """States of tracked balls; the first frame's velocity is taken to be the second's."""
    positions = np.stack([clips.history(place, frames) for place in places])
    halves = torch.from_numpy((positions / HALF_FRAME_PX - 1).astype(np.float32))
    moved = halves[:, :, 1:] - halves[:, :, :-1]
    return States(
        halves,
        torch.cat([moved[:, :, :1], moved], dim=2),
        torch.zeros(*halves.shape[:3], 3),
        torch.zeros(len(places), 3),
    )


def markdown(rows: Sequence[Measured], setup: SetupClips) -> str:
    """Make the table of a page."""
    moments = setup.moments
    heads = [f"T = {T}: px" for T in moments] + [f"in 50 / 95 % at T = {T}" for T in moments]
    lines: list[Sequence[str]] = []
    for row in rows:
        errors = [f"{mean:.1f} ± {spread:.1f}" for mean, spread in row.errors.values()]
        inside = ["-"] * len(moments)
        if row.inside is not None:
            inside = [f"{half:.2f} / {most:.2f}" for half, most in row.inside.values()]
        lines.append((row.method, row.balls, *errors, *inside))
    how_often = "every frame" if setup.every == 1 else f"every {setup.every} frames"
    shown = table(("method", "balls", *heads), lines)
    return f"{shown}\n\n{len(setup.places['test'])} windows, one {how_often}."
