"""What every other framework's program does with requests: the bare loop, from JSON to JSON."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.bench.loop import BareLoop, decoded

Request = dict[str, Any]
Answer = dict[str, Any]


class Answers:
    """Answers the very requests that the service gets, with the same figures in its answers."""

    def __init__(self) -> None:
        self._loop = BareLoop()

    def frames(self, encoded: Sequence[str]) -> np.ndarray:
        """Frames [4, 128, 128, 3] of four PNG files in base64."""
        return decoded([base64.b64decode(file) for file in encoded])

    def forecasts(self, images: Sequence[np.ndarray]) -> list[Answer]:
        """Forecasts of several requests, rolled out as one batch."""
        found = self._loop.forecast(np.stack(images))
        return [
            {name: values[index].tolist() for name, values in found.items()}
            for index in range(len(images))
        ]

    def answer(self, encoded: Sequence[str]) -> Answer:
        """Answer one request."""
        return self.forecasts([self.frames(encoded)])[0]
