"""Steps of a forecast that are not as far apart as those of a network."""

import math

import numpy as np

from rollcast.footage import is_among
from rollcast.manifest import Manifest
from rollcast.outputs import SPECS
from rollcast.rollout import Outputs


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

    def add(self, outputs: Outputs) -> list[Outputs]:
        """Take the network's next step, and return the forecast's steps up to it."""
        now, self._rolled = self._rolled, self._rolled + 1
        made: list[Outputs] = []
        while self._made < self._horizon:
            share = self._made * self.spacing - (now - 1)
            if share > 1 + 1e-9:
                break
            made.append(outputs if share > 1 - 1e-9 else self._between(outputs, share))
            self._made += 1
        self._before = outputs
        return made

    def _between(self, outputs: Outputs, share: float) -> Outputs:
        return {
            name: np.float32(1 - share) * self._before[name] + np.float32(share) * now
            if SPECS[name].is_per_step
            else now
            for name, now in outputs.items()
        }
