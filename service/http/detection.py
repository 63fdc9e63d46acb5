"""One detection request answered: decode, choose, find. Nothing is rolled out."""

import numpy as np

from rollcast.ball_finding import Sightings
from rollcast.rollout import Outputs
from rollcast.schemas import DetectedBall, DetectRequest, DetectResponse, SeenBall
from service.errors import InvalidValueError
from service.http.image_decoding import OpenedFrames
from service.http.request_body import Parser
from service.inference.ball_predictor import BallPredictor
from service.inference.deadlines import CancellationToken
from service.inference.scheduler import Decoding
from service.serving.registry import ModelQuery, Registry


class Detection:
    """Job of the scheduler that detects balls.

    Parameters
    ----------
    parse
        Parser of the request, which calls its argument regularly as a check for cancellation.
    token
        Cancels the work when the client has disconnected.
    """

    def __init__(
        self, parse: Parser[DetectRequest], token: CancellationToken, registry: Registry
    ) -> None:
        self._parse = parse
        self._token = token
        self._registry = registry
        self._answer: str | None = None

    def begin(self) -> Decoding:
        """Detect the balls, or return a function that does so if decoding the frames is slow.

        Raises
        ------
        service.errors.ServiceError
            When the request cannot be served.
        """
        request, _ = self._parse(self._token.raise_if_cancelled)
        fields = [f"frames[{index}]" for index in range(len(request.frames))]
        opened = OpenedFrames(request.frames, fields, self._token.raise_if_cancelled)
        predictor = self._registry.choose(
            ModelQuery(request.model, None, square=False, prompted=True)
        )
        if not isinstance(predictor, BallPredictor):
            expected = "a model for any number of balls"
            raise InvalidValueError.at("model", request.model, expected)

        def find() -> None:
            frames = opened.decode_whole()
            found = predictor.sight(frames, request.min_score, refine_still=request.refine_still)
            self._answer = _written(predictor.manifest.label, frames, found)

        return find if opened.slow else find()

    def take(self, outputs: Outputs) -> None:
        """Take no steps: there is no rollout."""

    def finish(self) -> str:
        """Return the answer, JSON."""
        assert self._answer is not None
        return self._answer


def _written(label: str, frames: np.ndarray, found: Sightings) -> str:
    balls = [
        DetectedBall(
            score=round(score, 4),
            moving=round(moving, 4),
            refined=refined,
            seen=[SeenBall(x=x, y=y, radius=radius) for x, y in path],
            visible=[round(share, 4) for share in visible],
        )
        for path, radius, score, moving, visible, refined in zip(
            found.paths.tolist(),
            found.radii.tolist(),
            found.scores.tolist(),
            found.moving.tolist(),
            found.visible.tolist(),
            found.refined.tolist(),
            strict=True,
        )
    ]
    size = (frames.shape[2], frames.shape[1])
    return DetectResponse(model=label, frame_size=size, balls=balls).model_dump_json()
