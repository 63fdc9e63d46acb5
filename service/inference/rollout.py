"""Networks that can be rolled out, and forecasts from their outputs, in 128-pixel units.

Axes: B requests, N balls, T steps, K frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import GAUSSIAN_ELLIPSE50_RADIUS, CovarianceSource, Manifest
from rollcast.ood import OodDetector
from rollcast.outputs import STEP_OUTPUTS, OutputName, Units, rescaled
from rollcast.rollout import Arrays, Step, Steps
from service.errors import DivergedError

MARGIN_PX = NETWORK_FRAME_SIZE / 10
LARGEST_SIGMA_PX = NETWORK_FRAME_SIZE / 2


@runtime_checkable
class Predictor(Protocol):
    """A network that can be rolled out. ``service.inference.onnx_runtime`` has the real one."""

    manifest: Manifest
    ood_detector: OodDetector | None
    """Statistics of the training frames; None for models without them."""

    def encode(
        self, frames: UInt8[np.ndarray, "B K 128 128 3"], *, two_cores: bool = False
    ) -> Step:
        """Return the first state and the outputs of step t = 0.

        Parameters
        ----------
        two_cores
            Whether another core is idle and may help.
        """
        ...

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        ...


@dataclass(frozen=True)
class ForecastArrays:
    """A forecast of B requests, with an uncertainty from one source or the other."""

    outputs: Mapping[OutputName, np.ndarray]
    """Outputs [B, N, T, ...] that the model has, those of no step [B, N, ...]."""
    ellipse50_radii: Float[np.ndarray, " T"]
    """Standard deviations: radii of the ellipses that should contain half of the true positions."""

    @property
    def positions(self) -> Float[np.ndarray, "B N T 2"]:
        """Pixels."""
        return self.outputs["positions"]

    @property
    def covariances(self) -> Float[np.ndarray, "B N T 2 2"]:
        """Square pixels."""
        return self.outputs["covariances"]

    def having(self, **outputs: np.ndarray) -> "ForecastArrays":
        """Return the forecast with other values of some outputs."""
        return replace(self, outputs={**self.outputs, **outputs})

    def mixed(self, other: "ForecastArrays", balls: Bool[np.ndarray, " N"]) -> "ForecastArrays":
        """Return the forecast with the positions and covariances of some balls from another one."""
        chosen = balls[:, None, None]
        return self.having(
            positions=np.where(chosen, other.positions, self.positions),
            covariances=np.where(chosen[..., None], other.covariances, self.covariances),
        )

    def within_frame(self) -> "ForecastArrays":
        """Return the forecast with places near the 128-pixel frame and bounded covariances.

        A ball that leaves the frame is answered at most :data:`MARGIN_PX` outside of it, and no
        standard deviation exceeds :data:`LARGEST_SIGMA_PX`.
        """
        largest = np.linalg.eigvalsh(self.covariances)[..., -1]
        shrink = np.minimum(1, LARGEST_SIGMA_PX**2 / np.maximum(largest, 1e-9))
        return self.having(
            positions=self.positions.clip(-MARGIN_PX, NETWORK_FRAME_SIZE + MARGIN_PX),
            covariances=self.covariances * shrink[..., None, None].astype(np.float32),
        )

    def rescaled(self, units: Units) -> "ForecastArrays":
        """Return the forecast in the units of other frames than 128-pixel ones."""
        return replace(self, outputs=rescaled(self.outputs, units))


def assemble(
    outputs: Mapping[OutputName, np.ndarray],
    covariance: CovarianceSource,
    first_step: int = 0,
    spacing: float = 1.0,
) -> ForecastArrays:
    """Make a forecast of stacked outputs: one of the two sources tells its covariances.

    Parameters
    ----------
    first_step
        Step that the outputs begin with.
    spacing
        Time between two steps, in those of ``covariance``.

    Raises
    ------
    DivergedError
        When a number is not finite.
    """
    positions = outputs["positions"]
    moments = spacing * np.arange(first_step, first_step + positions.shape[2], dtype=np.float64)
    steps = np.rint(moments).astype(np.intp)
    if covariance.empirical is not None:
        table = np.array(covariance.empirical)[_held(steps, len(covariance.empirical))]
        covariances = np.broadcast_to(table, (*positions.shape, 2))
    else:
        covariances = outputs["covariances"]
        if covariance.variance_scale is not None:
            scale = np.array(covariance.variance_scale)
            covariances = covariances * scale[_held(steps, len(scale)), None, None]
    half = np.array(covariance.ellipse50_radius or [GAUSSIAN_ELLIPSE50_RADIUS])
    forecast = ForecastArrays(
        {**outputs, "covariances": covariances}, half[_held(steps, len(half))]
    )
    _refuse_divergence(forecast, first_step)
    return forecast


def place_sigmas(made: ForecastArrays) -> list[float]:
    """Return the largest standard deviation of each ball's place at the first step, pixels."""
    return np.sqrt(np.linalg.eigvalsh(made.covariances[0, :, 0])[:, -1]).tolist()


class CovarianceFloor:
    """Keeps covariances from shrinking beyond the last calibrated step of a forecast.

    Parameters
    ----------
    calibrated
        Steps whose covariances were fitted to residuals.
    """

    def __init__(self, calibrated: int) -> None:
        self._calibrated = calibrated
        self._largest: Float[np.ndarray, "B N"] | None = None

    def apply(self, forecast: ForecastArrays, first_step: int) -> ForecastArrays:
        """Return the next steps of the forecast, whose first one is ``first_step``."""
        covariances = forecast.covariances
        traces = covariances[..., 0, 0] + covariances[..., 1, 1]
        steps = np.arange(first_step, first_step + traces.shape[2], dtype=np.intp)
        # Steps before the last calibrated one are no floor for those after it.
        floors = np.where(steps >= self._calibrated - 1, traces, 0.0)
        if self._largest is not None:
            floors = np.concatenate([self._largest[..., None], floors], axis=-1)
        floors = np.maximum.accumulate(floors, axis=-1)[..., -len(steps) :]
        self._largest = floors[..., -1]
        scale = np.maximum(1, floors / np.maximum(traces, 1e-9))
        scaled = covariances * scale[..., None, None].astype(np.float32)
        return forecast.having(covariances=scaled)


def _held(steps: np.ndarray, known: int) -> np.ndarray:
    """Index of each step in a table of ``known`` steps, the last of which is held beyond."""
    return np.minimum(steps, known - 1)


def _refuse_divergence(forecast: ForecastArrays, first_step: int) -> None:
    for spec in STEP_OUTPUTS:
        values = forecast.outputs.get(spec.name)
        if values is None or np.isfinite(values).all():
            continue
        by_step = np.isfinite(values).all(axis=(0, 1, *range(3, values.ndim)))
        finite = first_step + int(np.argmin(by_step))
        asked = first_step + values.shape[2]
        raise DivergedError.at("horizon", asked, f"at most {finite} for these frames")
