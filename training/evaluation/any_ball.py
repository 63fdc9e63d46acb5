"""Errors of detection and forecast of a network for any number of balls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.optimize import linear_sum_assignment

from rollcast.ball_finding import Arrays, Balls, by_motion, find_balls
from rollcast.camera import NETWORK_FRAME_SIZE
from training.data.ball_batch import BallWindow
from training.data.windows import Window
from training.evaluation.evaluate import EvaluationSet, Shown
from training.networks.any_ball import AnyBallNet, seen_balls
from training.networks.ball_detector import peaks
from training.objectives.metrics import Forecasts, beside_truth

HALF = NETWORK_FRAME_SIZE / 2


class TorchFinder:
    """A network's functions as :func:`rollcast.ball_finding.find_balls` asks for them."""

    def __init__(self, network: AnyBallNet) -> None:
        self.network = network.eval()

    def detect(self, frames: UInt8[np.ndarray, "1 4 128 128 3"]) -> Arrays:
        """Frames to candidates, votes and maps."""
        with torch.inference_mode():
            maps = self.network.perception.detector.maps(
                torch.from_numpy(np.ascontiguousarray(frames))
            )
            found = peaks(maps)
            votes = torch.cat(
                [
                    maps.places.flatten(1, 2), maps.log_radius[:, None],
                    maps.heat[:, None].sigmoid(), maps.moving[:, None].sigmoid(),
                ],
                dim=1,
            )  # fmt: skip
        said = {**found._asdict(), "votes": votes, "ground": maps.ground, "scene": maps.scene}
        return {name: value.numpy() for name, value in said.items()}

    def refine(
        self, patches: Float[np.ndarray, "balls 4 3 32 32"], wanted: Sequence[str]
    ) -> Arrays:
        """Return the requested outputs of patches."""
        with torch.inference_mode():
            said = self.network.perception.refiner(torch.from_numpy(patches.astype(np.float32)))
        return {name: getattr(said, name).numpy() for name in wanted}

    def find(
        self,
        frames: UInt8[np.ndarray, "4 height width 3"],
        prompts: Float[np.ndarray, "balls 2"] | None = None,
    ) -> tuple[Balls, Arrays]:
        """Find balls, see :func:`rollcast.ball_finding.find_balls`."""
        return find_balls(self.detect, self.refine, frames, prompts)

    def forecast(
        self, balls: Balls, said: Arrays, horizon: int, spacing: float = 1.0
    ) -> dict[str, np.ndarray]:
        """Positions [N, T, 2] in px of 128, covariances and angular velocities of the steps.

        Parameters
        ----------
        spacing
            Time between two seen frames, in steps.
        """

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(np.asarray(array, np.float32))[None]

        with torch.inference_mode():
            seen = seen_balls(
                tensor(balls.places), tensor(balls.radii), tensor(balls.visible),
                tensor(balls.log_sigmas), tensor(balls.features),
            )  # fmt: skip
            ground, scene = tensor(said["ground"][0]), tensor(said["scene"][0])
            state, _ = self.network.begin(seen, ground, scene, tensor(np.array(spacing)))
            made = self.network.roll_out(state, horizon)
        return {name: value[0].numpy() for name, value in made.outputs().items()}


def matched(found: Float[np.ndarray, "found 2"], truth: Float[np.ndarray, "balls 2"]) -> np.ndarray:
    """Index of the found ball that is each true one, by the least sum of distances."""
    apart = np.linalg.norm(found[None] - truth[:, None], axis=-1)
    rows, columns = linear_sum_assignment(apart)
    index = np.full(len(truth), -1)
    index[rows] = columns
    return index


def forecast_sets(
    finder: TorchFinder, sets: Sequence[EvaluationSet[Shown]]
) -> Mapping[Shown, Forecasts]:
    """Forecast the balls that move in every window up to T_gen, each beside the truth it is of."""
    return {part.scenario: forecast_windows(finder, part.windows, part.horizon) for part in sets}


def forecast_windows(finder: TorchFinder, windows: Sequence[Window], horizon: int) -> Forecasts:
    """Forecast windows of as many balls each, all of which move.

    A ball that was not found gets a forecast in the middle of the frame with a large covariance.
    """
    rows = [_forecast_one(finder, window, horizon) for window in windows]
    positions, covariances, spins = (np.stack(parts) for parts in zip(*rows, strict=True))
    return beside_truth(windows, positions, covariances, spins)


def _forecast_one(
    finder: TorchFinder, window: Window, horizon: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    count = len(window.positions)
    balls, said = finder.find(window.frames)
    balls = balls.taken(by_motion(balls)[:count])
    made = finder.forecast(balls, said, horizon)
    index = matched(made["positions"][:, 0], window.positions[:, 0])
    positions = np.full((count, horizon, 2), HALF, np.float32)
    covariances = np.tile(np.float32(HALF**2) * np.eye(2, dtype=np.float32), (count, horizon, 1, 1))
    spins = np.zeros((count, horizon, 3), np.float32)
    found = index >= 0
    positions[found] = made["positions"][index[found]]
    covariances[found] = made["covariances"][index[found]]
    spins[found] = made["angular_velocities"][index[found]]
    return positions, covariances, spins


PROMPT_PX = 1.5
"""Standard deviation of a click about a ball's centre, in px of 128."""
AHEAD = 5
"""Frames over which the last displacement is extrapolated in the validation error."""
LOST_PX = 20.0
"""Largest error of one ball in the validation error; a lost ball counts as much."""


@dataclass(frozen=True)
class SightErrors:
    """Errors at t = 0 of balls that move and are seen, in px of 128, one row per ball."""

    places: np.ndarray
    """Distance of the last observed place."""
    displacements: np.ndarray
    """Length of the error of the last displacement."""
    ahead: np.ndarray
    """Distance of the straight line through both after :data:`AHEAD` frames."""
    radii: np.ndarray
    """Radii of the true balls."""

    @property
    def found(self) -> float:
        """Share of balls whose place errs by at most their radius, or 2 px."""
        return float((self.places <= np.maximum(self.radii, 2)).mean())

    @property
    def mean_px(self) -> float:
        """Mean error of the straight line, of which lost balls take :data:`LOST_PX`."""
        return float(self.ahead.clip(max=LOST_PX).mean())


def sight_errors(
    network: AnyBallNet, windows: Sequence[BallWindow], *, prompted: bool, seed: int = 0
) -> SightErrors:
    """Measure how exactly a network sees the balls that move in some windows.

    Parameters
    ----------
    prompted
        Whether a point near each ball's centre selects it; otherwise the nearest ball that was
        found counts.
    seed
        Of the points.
    """
    finder = TorchFinder(network)
    generator = np.random.default_rng(seed)
    rows: list[tuple[float, float, float, float]] = []
    for window in windows:
        wanted = (window.moving > 0) & (window.visible[:, -1] > 0.5)
        truths = HALF * window.places[wanted]
        if not len(truths):
            continue
        clicks = truths[:, -1] + generator.normal(0, PROMPT_PX, truths[:, -1].shape)
        balls, _ = finder.find(window.frames, clicks / HALF if prompted else None)
        found = HALF * balls.places
        for index, (truth, radius) in enumerate(
            zip(truths, HALF * window.radii[wanted], strict=True)
        ):
            away = np.linalg.norm(found[:, -1] - truth[-1], axis=-1)
            error = found[index if prompted else int(away.argmin())] - truth
            step = error[-1] - error[-2]
            line = error[-1] + AHEAD * step
            lengths = (float(np.linalg.norm(part)) for part in (error[-1], step, line))
            rows.append((*lengths, float(radius)))  # pyright: ignore[reportArgumentType]
    return SightErrors(*np.array(rows).T)


def validation_errors(
    network: AnyBallNet, windows: Sequence[BallWindow]
) -> tuple[float, Mapping[str, float]]:
    """Return the mean error with and without prompts, and its parts."""
    told = sight_errors(network, windows, prompted=True)
    free = sight_errors(network, windows, prompted=False)
    error = (told.mean_px + free.mean_px) / 2
    return error, {
        "validation/error": error,
        "validation/prompted": told.mean_px,
        "validation/unprompted": free.mean_px,
        "validation/displacement": float(np.median(told.displacements)),
    }
