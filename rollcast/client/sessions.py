"""Sessions without their transport: address, options, answers and errors, for both clients."""

import json
import uuid
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import httpx2

from rollcast.client.answers import MAX_ANSWER_BYTES, failure, problem_error, shown
from rollcast.client.calls import Call
from rollcast.client.connection import Target
from rollcast.client.results import Forecast
from rollcast.errors import (
    ClientError,
    ProblemError,
    RequestTimeoutError,
    UnexpectedAnswerError,
    UnreachableError,
)
from rollcast.schemas import REQUEST_ID_HEADER, TickResponse, TickStatus

CLOSE_TIMEOUT_S = 2.0
"""Longest wait for the other side to close a connection."""
NOT_FOUND = 404


@contextmanager
def handshake() -> Generator[None]:
    """Report a peer that sends bytes or disconnects before the request as one without sessions.

    ``websockets.sync`` raises ``InvalidMessage`` when the peer's bytes, or their end, arrive after
    the request was sent. Before that it raises ``ConnectionClosed``, or an assertion of its own
    fails (16.1).

    Raises
    ------
    websockets.exceptions.InvalidMessage
        In all three cases.
    """
    from websockets.exceptions import ConnectionClosed, InvalidMessage

    try:
        yield
    except (ConnectionClosed, AssertionError) as error:
        raise InvalidMessage("did not receive a valid HTTP response") from error


class LocalSession(Protocol):
    """A session without a network: its answers are there when ``send`` returns."""

    def send(self, message: str | bytes) -> None:
        """Take a message."""
        ...

    def receive(self) -> str | bytes | None:
        """Return the next answer; None when there is none."""
        ...


@runtime_checkable
class SessionTransport(Protocol):
    """A transport that opens sessions of its own."""

    def open_session(self, message: str) -> LocalSession:
        """Open a session, whose first message is given and sent again."""
        ...


@dataclass(frozen=True)
class TickAnswer:
    """Answer to one frame of a session."""

    tick: int
    """Number of the frame, as ``send`` returned it."""
    status: TickStatus
    """Outcome: ``collecting`` for the first three frames, ``forecast``, ``superseded`` if a newer
    frame
    arrived before the forecast from this one was begun, or ``refused``."""
    latency_ms: float
    """Time from the receipt of the frame by the service to its answer."""
    forecast: Forecast | None
    """The forecast from this frame and the three before it, with the status ``forecast``."""
    error: ProblemError | None
    """The problem document as the exception that ``predict`` would raise, with the status
    ``refused``."""


class SessionCall:
    """One session: its request and the order of its answers.

    Parameters
    ----------
    target
        The service.
    call
        The options.
    """

    def __init__(self, target: Target, call: Call[Forecast]) -> None:
        base = target.base_url
        self.url = base.copy_with(
            scheme={"http": "ws", "https": "wss"}[base.scheme],
            path=base.path.rstrip("/") + call.path,
        )
        self.first_message = json.dumps(call.json)
        self._target = target
        self._call = call
        self._request_id = uuid.uuid4().hex
        self._answered = -1

    def options(self) -> dict[str, Any]:
        """Return the arguments of a connection."""
        headers = {REQUEST_ID_HEADER: self._request_id, **self._target.options()["headers"]}
        proxy = self._target.proxy
        return {
            "additional_headers": headers,
            "proxy": None if proxy is None else proxy.url,
            "compression": None,  # frames are compressed images
            "max_size": MAX_ANSWER_BYTES,
            "close_timeout": CLOSE_TIMEOUT_S,
        }

    def begin(self) -> None:
        """Expect the answer to the first message."""
        self._answered = -1

    def take(self, text: str | bytes) -> TickAnswer:
        """Read the next answer.

        Raises
        ------
        ProblemError
            When the options are refused.
        UnexpectedAnswerError
            When it is not an answer of this API, or not the next one.
        """
        try:
            response = TickResponse.model_validate_json(text)
            if response.tick != self._answered + 1:
                raise ValueError(f"tick {response.tick} follows tick {self._answered}")
            forecast = response.forecast
            answer = TickAnswer(
                tick=response.tick,
                status=response.status,
                latency_ms=response.latency_ms,
                forecast=None if forecast is None else self._finished(forecast),
                error=None if response.problem is None else self._error(response),
            )
            for status, part in (("forecast", answer.forecast), ("refused", answer.error)):
                if (answer.status == status) != (part is not None):
                    raise ValueError(f"tick {answer.tick} has the status {answer.status!r}")
        except ValueError as error:
            raise UnexpectedAnswerError(
                f"{shown(self.url)} sent an answer that cannot be read: {error}"
            ) from error
        self._answered = response.tick
        if answer.tick == 0 and answer.error is not None:
            raise answer.error
        return answer

    @contextmanager
    def translated(self, limit_s: float) -> Generator[None]:
        """Turn every error of the connection into a ``ClientError``.

        Raises
        ------
        RequestTimeoutError
            When the time is over.
        UnreachableError
            When there is no connection, or no longer.
        ProblemError
            When the service refuses the session.
        UnexpectedAnswerError
            When the answer is not one of a WebSocket.
        """
        from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

        proxy = self._target.proxy
        way = f" through the proxy {proxy}, which NO_PROXY avoids" if proxy else ""
        url = shown(self.url)
        try:
            try:
                yield
            except ClientError:
                raise
            except TimeoutError as error:
                raise RequestTimeoutError(
                    f"{url} did not answer within {limit_s:g} s{way}"
                ) from error
            except InvalidStatus as error:
                raise self._refusal(error.response) from error
            except ConnectionClosed as error:
                raise UnreachableError(f"{url} ended the session{way}: {error}") from error
            except WebSocketException as error:
                raise UnexpectedAnswerError(f"{url} opens no session{way}: {error}") from error
            except (OSError, EOFError) as error:
                raise UnreachableError(f"{url} does not answer{way}: {error}") from error
        except ClientError as error:
            error.request_id = error.request_id or self._request_id
            raise

    def _refusal(self, response: Any) -> ClientError:  # noqa: ANN401 - websockets.http11.Response
        """Return the exception for a handshake that is refused."""
        http = httpx2.Response(
            response.status_code,
            headers=list(response.headers.raw_items()),
            request=httpx2.Request("GET", self.url),
        )
        error = failure(http, response.body or b"")
        if isinstance(error, ProblemError) and error.status_code == NOT_FOUND:
            error.advice = (
                "the service is older than sessions, or a proxy does not pass WebSockets on"
            )
        return error

    def _finished(self, response: Any) -> Forecast:  # noqa: ANN401
        return self._call.finish(Forecast.from_response(response))

    def _error(self, response: TickResponse) -> ProblemError:
        assert response.problem is not None
        error = problem_error(response.problem)
        error.advice = self._call.advise(response.problem)
        error.request_id = self._request_id
        return error


def newest_of(answers: Iterable[TickAnswer]) -> TickAnswer | None:
    """Return the newest forecast or refusal, without one the newest answer; None of none."""
    newest = None
    for answer in answers:
        if newest is None or answer.status in {"forecast", "refused"} or not _tells(newest):
            newest = answer
    return newest


def _tells(answer: TickAnswer) -> bool:
    return answer.status in {"forecast", "refused"}
