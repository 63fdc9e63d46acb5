"""Metrics of forecasts, in pixels of 128 x 128 frames, rad/s and nats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from rollcast.manifest import gaussian_radius
from training.data.windows import Window, collate
from training.networks.recurrent import Family, Observation
from training.objectives.losses import negative_log_likelihood

HALF = 0.5
"""Share of the truths for which ellipses may have a radius of their own."""


@dataclass(frozen=True)
class Forecasts:
    """Forecasts of several sequences beside their truth.

    ``covariances`` and ``angular_velocities`` are None where the network has no such output.
    """

    positions: Float[np.ndarray, "sequences objects steps 2"]
    covariances: Float[np.ndarray, "sequences objects steps 2 2"] | None
    angular_velocities: Float[np.ndarray, "sequences objects steps 3"] | None
    true_positions: Float[np.ndarray, "sequences objects steps 2"]
    true_angular_velocities: Float[np.ndarray, "sequences objects steps 3"]
    ellipse50_radii: Float[np.ndarray, " steps"] | None = None
    """Standard deviations: of the ellipses that should hold half of the truths; None: a
    Gaussian's."""

    def of_balls(self, chosen: slice) -> "Forecasts":
        """Return those of some balls alone."""
        covariances, spins = self.covariances, self.angular_velocities
        return Forecasts(
            self.positions[:, chosen],
            None if covariances is None else covariances[:, chosen],
            None if spins is None else spins[:, chosen],
            self.true_positions[:, chosen],
            self.true_angular_velocities[:, chosen],
            self.ellipse50_radii,
        )

    def errors_px(self) -> Float[np.ndarray, "sequences objects steps"]:
        """Distance to the truth at every step."""
        return np.linalg.norm(self.positions - self.true_positions, axis=-1)

    def angular_velocity_rmse(self) -> Float[np.ndarray, " steps"] | None:
        """Root of the mean squared length of the angular velocity error, at every step."""
        if self.angular_velocities is None:
            return None
        squared = np.sum((self.angular_velocities - self.true_angular_velocities) ** 2, axis=-1)
        return np.sqrt(squared.mean(axis=(0, 1)))

    def nll_nats(self) -> Float[np.ndarray, " steps"] | None:
        """Mean negative log likelihood in nats, as in the paper's tables."""
        if self.covariances is None:
            return None
        nll = negative_log_likelihood(
            torch.from_numpy(self.positions),
            torch.from_numpy(self.covariances),
            torch.from_numpy(self.true_positions),
        )
        return nll.mean(dim=(0, 1)).numpy()

    def calibration(
        self, levels: Sequence[float]
    ) -> dict[float, Float[np.ndarray, " steps"]] | None:
        """Share of truths inside the ellipses that should hold shares ``levels``, at every step."""
        if self.covariances is None:
            return None
        distances = distances_sigmas(self.true_positions - self.positions, self.covariances)
        radii: dict[float, float | np.ndarray] = {level: gaussian_radius(level) for level in levels}
        if self.ellipse50_radii is not None and HALF in radii:
            radii[HALF] = self.ellipse50_radii
        return {level: (distances <= radius).mean(axis=(0, 1)) for level, radius in radii.items()}


def distances_sigmas(
    residuals: Float[np.ndarray, "*any 2"], covariances: Float[np.ndarray, "*any 2 2"]
) -> Float[np.ndarray, "*any"]:
    """Return how many standard deviations a truth is away (Mahalanobis distance)."""
    solved = np.linalg.solve(covariances, residuals[..., None])[..., 0]
    return np.sqrt(np.sum(residuals * solved, axis=-1))


def forecast(
    family: Family, windows: Sequence[Window], horizon: int, device: torch.device
) -> Mapping[str, Forecasts]:
    """Run networks over windows, in float32 and in batches; return every member's forecasts."""
    family.eval()
    observed: dict[str, list[Observation]] = {name: [] for name in family.networks()}
    batch_size = 50
    with torch.inference_mode():
        for first in range(0, len(windows), batch_size):
            batch = collate(windows[first : first + batch_size])
            for name, observation in family(batch["frames"].to(device), horizon).items():
                observed[name].append(observation)
    made: dict[str, Forecasts] = {}
    for name, parts in observed.items():
        positions = _joined([part.positions for part in parts])
        assert positions is not None
        covariances = _joined([part.covariances for part in parts])
        spins = _joined([part.angular_velocities for part in parts])
        made[name] = beside_truth(windows, positions, covariances, spins)
    return made


def beside_truth(
    windows: Sequence[Window],
    positions: np.ndarray,
    covariances: np.ndarray | None,
    angular_velocities: np.ndarray | None,
) -> Forecasts:
    """Put forecasts of windows, of any horizon, beside their truth."""
    steps = positions.shape[2]
    return Forecasts(
        positions,
        covariances,
        angular_velocities,
        np.stack([w.positions[:, :steps] for w in windows]).astype(np.float32),
        np.stack([w.angular_velocities[:, :steps] for w in windows]).astype(np.float32),
    )


def _joined(parts: Sequence[torch.Tensor | None]) -> np.ndarray | None:
    """Batches of an output as one array; None when the network has no such output."""
    tensors = [part.float().cpu() for part in parts if part is not None]
    return torch.cat(tensors).numpy() if tensors else None


def constant_positions(positions: Float[np.ndarray, "sequences objects steps 2"]) -> np.ndarray:
    """Forecast that every ball rests where it is at t = 0."""
    return np.broadcast_to(positions[:, :, :1], positions.shape)
