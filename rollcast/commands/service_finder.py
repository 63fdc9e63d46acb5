"""Perception of a running service, for :mod:`rollcast.tracking`."""

import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from rollcast.ball_finding import Sightings
from rollcast.client import Client
from rollcast.schemas import AUTO_MODEL
from rollcast.tracking.finder import LEAST_SCORE

JPEG_QUALITY = 95


class ServiceFinder:
    """Finds balls through ``POST /detect``.

    Parameters
    ----------
    client
        Of the service; its calls are made from several threads.
    model
        "auto", NAME or NAME@VERSION of a model for any number of balls.
    """

    def __init__(self, client: Client, model: str = AUTO_MODEL) -> None:
        self._client = client
        self._model = model

    def prepare(self, picture: UInt8[np.ndarray, "height width 3"], /) -> bytes:
        """Encode a picture; PNG files take several times as long, and the place is the same."""
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
        return buffer.getvalue()

    def find(self, frames: Sequence[bytes], /) -> Sightings:
        """Find the balls of four encoded pictures.

        Raises
        ------
        rollcast.errors.ClientError
            When the call fails.
        """
        found = self._client.detect(
            frames, model=self._model, min_score=LEAST_SCORE, refine_still=False
        )
        return Sightings(
            found.seen[..., :2],
            found.seen[:, -1, 2],
            found.scores,
            found.moving,
            found.visible,
            found.refined,
        )
