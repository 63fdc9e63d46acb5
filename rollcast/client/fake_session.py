"""The sessions of ``rollcast.client.testing``: every frame is answered at once."""

from collections import deque
from collections.abc import Callable

import numpy as np
from pydantic import ValidationError

from rollcast.client import fakes
from rollcast.client.fakes import RefusalError
from rollcast.schemas import PredictRequest, Problem, SessionRequest, TickResponse
from rollcast.trajectory import OBSERVED_FRAMES


class FakeSession:
    """One session of a fake service.

    Parameters
    ----------
    positions, variance_px2
        As for ``FakeService``.
    problem
        Returns the document that refuses frames; None to answer.
    frames
        List that takes the frames as they are sent.
    """

    def __init__(
        self,
        positions: np.ndarray | None,
        variance_px2: float,
        problem: Callable[[], Problem | None],
        frames: list[bytes],
    ) -> None:
        self._positions, self._variance_px2 = positions, variance_px2
        self._problem = problem
        self._frames = frames
        self._request: SessionRequest | None = None
        self._window: list[bytes] = []
        self._ticks = 0
        self._answers: deque[str] = deque()

    def send(self, message: str | bytes) -> None:
        """Take the options, and after them frames."""
        if self._request is None or isinstance(message, str):
            answer = self._begin(message)
        else:
            answer = self._tick(message)
        self._answers.append(answer.model_dump_json())

    def receive(self) -> str | None:
        """Return the next answer; None when there is none."""
        return self._answers.popleft() if self._answers else None

    def _begin(self, message: str | bytes) -> TickResponse:
        try:
            self._request = SessionRequest.model_validate_json(message)
        except ValidationError as error:
            return _refused(0, fakes.invalid(error))
        return TickResponse(tick=0, status="open", latency_ms=0)

    def _tick(self, frame: bytes) -> TickResponse:
        assert self._request is not None
        self._ticks += 1
        self._frames.append(frame)
        self._window = [*self._window, frame][-OBSERVED_FRAMES:]
        if (problem := self._problem()) is not None:
            return _refused(self._ticks, problem)
        missing = OBSERVED_FRAMES - len(self._window)
        request = PredictRequest.model_construct(
            **dict(self._request), frames=[*self._window[:1] * missing, *self._window]
        )
        try:
            forecast = fakes.forecast(request, self._positions, self._variance_px2)
        except RefusalError as refusal:
            self._window = []
            return _refused(self._ticks, refusal.problem)
        if missing:
            return TickResponse(tick=self._ticks, status="collecting", latency_ms=0)
        return TickResponse(tick=self._ticks, status="forecast", latency_ms=0, forecast=forecast)


def _refused(tick: int, problem: Problem) -> TickResponse:
    return TickResponse(tick=tick, status="refused", latency_ms=0, problem=problem)
