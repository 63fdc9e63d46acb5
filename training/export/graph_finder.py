"""Perception of an artefact in this process, for :mod:`rollcast.tracking`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rollcast.ball_finding import Sightings, sight_balls
from rollcast.tracking.finder import LEAST_SCORE
from training.export.any_ball import BallGraphs


class GraphFinder:
    """Finds balls with the graphs of an artefact.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION`` of a model for any number of balls.
    """

    def __init__(self, folder: Path) -> None:
        self._graphs = BallGraphs(folder)

    def prepare(self, picture: UInt8[np.ndarray, "height width 3"], /) -> np.ndarray:
        """Return the picture."""
        return picture

    def find(self, frames: Sequence[np.ndarray], /) -> Sightings:
        """Find the balls of four pictures."""
        return sight_balls(
            self._graphs.detect,
            self._graphs.refine,
            np.stack(frames),
            LEAST_SCORE,
            refine_still=False,
        )
