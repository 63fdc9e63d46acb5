"""Steps of a forecast that are not as far apart as those of a network."""

import math

import numpy as np

from rollcast.footage import is_among
from rollcast.manifest import Manifest
from rollcast.outputs import SPECS
from rollcast.rollout import Outputs

TOLERANCE = 1e-6
"""Difference of times, in steps of the network, that is none."""


def reads_rate(manifest: Manifest, frame_rate: float) -> bool:
    """Return whether a model is told the rate of frames that are so many a second."""
    rates = manifest.frame_rates_hz
    return rates is not None and is_among(frame_rate, rates)


def frame_spacing(manifest: Manifest, frame_rate: float) -> float:
    """Return the time between two seen frames in a model's steps; 1 if it cannot be told it."""
    return manifest.frame_rate_hz / frame_rate if reads_rate(manifest, frame_rate) else 1.0


class StepTimes:
    """Turns a network's steps, as they come, into steps that are another time apart.

    Between two steps of the network every output is interpolated linearly.

    Parameters
    ----------
    spacing
        Time between two steps of the forecast, in steps of the network.
    horizon
        Steps of the forecast.
    """

    def __init__(self, spacing: float, horizon: int) -> None:
        self.spacing, self._horizon = spacing, horizon
        self._rolled = 0
        self._made = 0
        self._before: Outputs = {}

    @property
    def rollout_horizon(self) -> int:
        """Steps of the network, the last of which is not before the forecast's last one."""
        last = (self._horizon - 1) * self.spacing
        nearest = round(last)
        return 1 + (nearest if math.isclose(last, nearest) else math.ceil(last))

    def add(self, outputs: Outputs) -> Outputs:
        """Take the network's next steps, and return the forecast's steps up to the last of them.

        Both are [T, B, N, ...]; there may be none to return. Outputs of no step stay as they are.
        """
        if self.spacing == 1:
            return outputs
        of_steps = {name: values for name, values in outputs.items() if SPECS[name].is_per_step}
        known = {
            name: np.concatenate([self._before[name], values]) if self._before else values
            for name, values in of_steps.items()
        }
        self._before = {name: values[-1:] for name, values in of_steps.items()}
        self._rolled += len(outputs["positions"])
        count = len(known["positions"])
        passed = 1 + math.floor((self._rolled - 1 + TOLERANCE) / self.spacing)
        made = np.arange(self._made, min(passed, self._horizon))
        self._made += len(made)
        times = self.spacing * made - (self._rolled - count)
        low = np.floor(times + TOLERANCE).astype(np.intp)
        share = (times - low).clip(0).astype(np.float32)
        share[share < TOLERANCE] = 0
        # A step that lies on one of the network's does not depend on the next one.
        high = np.minimum(low + (share > 0), count - 1)
        between = {
            name: _between(values[low], values[high], share) for name, values in known.items()
        }
        return {**outputs, **between}


def _between(before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    share = share.reshape(-1, *[1] * (before.ndim - 1))
    return (1 - share) * before + share * after
