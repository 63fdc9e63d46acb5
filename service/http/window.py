"""The last frames of a session, and the jobs of the scheduler that read them."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from rollcast.rollout import Outputs
from rollcast.schemas import PredictRequest, SessionRequest
from service.errors import InvalidValueError
from service.http.image_decoding import KeptImage, OpenedFrames
from service.http.prediction import WholeForecast
from service.inference.deadlines import CancellationToken
from service.inference.scheduler import Decoding
from service.observability.metrics import Metrics
from service.serving.registry import Registry


class WindowFrame(NamedTuple):
    """A frame of a session."""

    tick: int
    image: KeptImage

    @property
    def field(self) -> str:
        """Name of the frame in problem documents."""
        return f"ticks[{self.tick}]"


Window = Sequence[WindowFrame]
"""Frames in order, at most four."""


class FrameCheck:
    """A job that decodes the frames of a window that is not full yet.

    Parameters
    ----------
    window
        The frames.
    token
        Ends the work when the client has disconnected.
    """

    def __init__(self, window: Window, token: CancellationToken) -> None:
        self._window = window
        self._token = token

    def begin(self) -> Decoding:
        """Decode the frames, or return the function that does so if that is slow.

        Raises
        ------
        service.errors.ServiceError
            With the frame at fault.
        """
        opened = opened_window(self._window, self._token)

        def decode() -> None:
            opened.decode_whole()

        return decode if opened.slow else decode()

    def take(self, outputs: Outputs) -> None:
        """Take no steps: there is no rollout."""

    def finish(self) -> None:
        """Return nothing: the frames are decoded."""


class WindowForecast(WholeForecast):
    """A forecast from the four frames of a window.

    Parameters
    ----------
    request
        Options of the session.
    window
        Four frames.
    """

    def __init__(
        self,
        request: SessionRequest,
        window: Window,
        token: CancellationToken,
        registry: Registry,
        metrics: Metrics,
    ) -> None:
        self._window = window
        frames = [frame.image.data for frame in window]
        # Not validated again: the options have been, and the frames are checked when opened.
        body = PredictRequest.model_construct(**dict(request), frames=frames)
        super().__init__(lambda _: (body, []), token, registry, metrics)

    def _open(self) -> OpenedFrames:
        return opened_window(self._window, self._token)


def opened_window(window: Window, token: CancellationToken) -> OpenedFrames:
    """Read the headers of the frames that are not decoded yet.

    Raises
    ------
    service.errors.ServiceError
        With the frame at fault: a file that is no image, or the first frame whose size differs from
        the one before.
    """
    opened = OpenedFrames(
        [frame.image for frame in window],
        [frame.field for frame in window],
        token.raise_if_cancelled,
    )
    for before, frame in pairwise(window):
        if frame.image.size != before.image.size:
            (width, height), (old_width, old_height) = _size(frame), _size(before)
            expected = f"{old_width} x {old_height}, the size of the frame before"
            raise InvalidValueError.at(frame.field, f"{width} x {height}", expected)
    return opened


def _size(frame: WindowFrame) -> tuple[int, int]:
    assert frame.image.size is not None
    return frame.image.size
