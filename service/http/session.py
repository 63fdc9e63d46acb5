"""One session: a frame a tick in, an answer for every tick out, the newest frame first.

The receiving task only notes frames. One other task answers: it takes the newest frame, answers the
older ones without a forecast, has the forecast computed and sends it, and begins again. So there is
never more than one forecast of a session at a time, and answers are in the order of ticks.
"""

import asyncio
import logging
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from fastapi import WebSocket, WebSocketDisconnect
from starlette.status import (
    WS_1003_UNSUPPORTED_DATA,
    WS_1008_POLICY_VIOLATION,
    WS_1012_SERVICE_RESTART,
)

from rollcast.schemas import DEFAULT_HORIZON, SessionRequest, TickStatus
from rollcast.trajectory import OBSERVED_FRAMES
from service.errors import (
    BodyTooLargeError,
    BodyTooSlowError,
    MalformedBodyError,
    ServiceError,
    TooManyBodiesError,
)
from service.http.authorization import check_access
from service.http.image_decoding import KeptImage
from service.http.problem_details import document
from service.http.request_body import parse_json
from service.http.window import FrameCheck, Window, WindowForecast, WindowFrame
from service.inference.body_budget import HeldBody
from service.inference.deadlines import awaited
from service.serving.registry import ModelQuery
from service.state import AppState

MAX_REQUEST_BYTES = 64 * 1024
"""Bytes of a session's first message, which is parsed in the event loop."""
MAX_UNANSWERED = 1000
"""Frames without an answer beyond which nothing is read: the client sends faster than it reads."""
LONGEST_REASON = 120
"""Bytes of the reason in a close frame, of which the protocol allows 123."""

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Tick:
    """A message without an answer."""

    number: int
    received: float
    collecting: bool = False
    """AppState before the fourth frame."""
    refusal: ServiceError | None = None
    """Reason for which the frame was not taken."""


class _Answer(NamedTuple):
    """An answer before it is written."""

    status: TickStatus
    part: str = ""
    """Further members of the JSON object, a comma before each."""


class ForecastSession:
    """The session of one WebSocket, which has been accepted.

    Parameters
    ----------
    websocket
        The connection.
    service
        The running service.
    timeout_s
        Time limit of every forecast, seconds.
    """

    def __init__(self, websocket: WebSocket, service: AppState, timeout_s: float) -> None:
        self._websocket = websocket
        self._service = service
        self._timeout_s = timeout_s
        self._request = SessionRequest()
        self._window: list[WindowFrame] = []
        self._held = HeldBody()
        self._held.give_up = self._drop_frames
        self._count = 0
        self._unanswered: deque[_Tick] = deque()
        self._arrived = asyncio.Event()
        self._room = asyncio.Event()
        self._close: tuple[int, str] | None = None
        """Close code and reason, once no further frame is taken."""

    async def run(self) -> None:
        """Answer until the client leaves or the service drains."""
        # A disconnected client is no error: there is no response to send.
        with self._service.session(), suppress(WebSocketDisconnect):
            try:
                if await self._open():
                    await self._serve()
            finally:
                self._service.bodies.resize(self._held, 0)

    async def _open(self) -> bool:
        """Read the options; return whether they are accepted."""
        first = _Tick(0, time.perf_counter())
        try:
            self._request = await self._received_options(first)
        except ServiceError as error:
            await self._send(first, self._refused(error))
            await self._websocket.close(WS_1008_POLICY_VIOLATION, error.title)
            return False
        await self._send(first, _Answer("open"))
        return True

    async def _received_options(self, first: _Tick) -> SessionRequest:
        seconds = self._service.settings.read_timeout_s
        try:
            async with asyncio.timeout(seconds):
                message = await self._websocket.receive()
        except TimeoutError as error:
            raise BodyTooSlowError(f"No message arrived within {seconds:g} s.") from error
        first.received = time.perf_counter()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1006))
        if (text := message.get("text")) is None:
            raise MalformedBodyError("The first message is text: the options as JSON, such as {}.")
        data = text.encode()
        if len(data) > MAX_REQUEST_BYTES:
            raise BodyTooLargeError.at("body", len(data), f"at most {MAX_REQUEST_BYTES} bytes")
        request = parse_json(data, SessionRequest)
        # Refused now instead of with the fourth frame. A rectangle may need another model.
        self._service.registry.choose(
            ModelQuery(
                request.model,
                request.num_objects,
                request.scenario,
                square=True,
                horizon=request.horizon or DEFAULT_HORIZON,
            )
        )
        return request

    async def _serve(self) -> None:
        """Take and answer frames, side by side."""
        reader = asyncio.create_task(self._read())
        answering = asyncio.create_task(self._answer_all())
        draining = asyncio.create_task(self._service.draining.wait())
        try:
            await asyncio.wait({reader, answering, draining}, return_when=asyncio.FIRST_COMPLETED)
            if draining.done() and self._close is None:
                self._close = WS_1012_SERVICE_RESTART, "the service is stopping"
            if self._close is not None and not answering.done():
                reader.cancel()
                self._arrived.set()
                await asyncio.wait({answering})
            ended = [task for task in (reader, answering) if task.done() and not task.cancelled()]
            errors = [error for task in ended if (error := task.exception()) is not None]
            if errors:
                raise errors[0]
            if self._close is not None:
                await self._websocket.close(*self._close)
        finally:
            for task in (reader, answering, draining):
                task.cancel()

    async def _read(self) -> None:
        """Take frames until the client leaves or sends something else."""
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            if data is None:
                self._close = WS_1003_UNSUPPORTED_DATA, "after the first message, send frames"
                return
            self._take(data)
            while len(self._unanswered) >= MAX_UNANSWERED:
                self._room.clear()
                await self._room.wait()

    def _take(self, data: bytes) -> None:
        """Put a frame into the window."""
        self._count += 1
        tick = _Tick(self._count, time.perf_counter())
        self._window = [*self._window, WindowFrame(self._count, KeptImage(data))][-OBSERVED_FRAMES:]
        tick.collecting = len(self._window) < OBSERVED_FRAMES
        self._unanswered.append(tick)
        try:
            self._count_bytes()
        except (BodyTooLargeError, TooManyBodiesError) as error:
            self._window = []
            tick.refusal = error
        self._arrived.set()

    def _count_bytes(self) -> None:
        """Hold the bytes of the window in the budget of bodies.

        Raises
        ------
        BodyTooLargeError
            When the files of the window are larger than a request with them may be.
        TooManyBodiesError
            When there is no room for them.
        """
        limit = self._service.settings.max_body_bytes
        files = sum(len(frame.image.data) for frame in self._window)
        if files > limit:
            self._service.bodies.resize(self._held, 0)
            expected = f"at most {limit} bytes in {OBSERVED_FRAMES} frames"
            raise BodyTooLargeError.at(f"ticks[{self._count}]", files, expected)
        held = sum(frame.image.held_bytes for frame in self._window)
        try:
            self._service.bodies.resize(self._held, held)
        except TooManyBodiesError:
            for frame in self._window:
                frame.image.forget_pixels()
            self._service.bodies.resize(self._held, files)

    def _drop_frames(self) -> None:
        """Give up the window, whose bytes other requests need."""
        self._window = []
        for tick in self._unanswered:
            tick.refusal = self._service.bodies.exceeded()

    async def _answer_all(self) -> None:
        """Answer every tick in order; the newest one with a forecast."""
        while (tick := await self._next()) is not None:
            newest = not self._unanswered
            self._room.set()
            await self._send(tick, await self._answer(tick, newest))

    async def _next(self) -> _Tick | None:
        """Return the next tick; None when no further one comes."""
        while not self._unanswered:
            if self._close is not None:
                return None
            self._arrived.clear()
            await self._arrived.wait()
        return self._unanswered.popleft()

    async def _answer(self, tick: _Tick, newest: bool) -> _Answer:
        if tick.refusal is not None:
            return self._refused(tick.refusal)
        if not newest:
            return _Answer("collecting" if tick.collecting else "superseded")
        window = tuple(self._window)
        try:
            return await self._forecast(window)
        except Exception as error:  # refusals, and failures of the service: the session goes on
            self._restart_after(error, window)
            return self._refused(error)

    async def _forecast(self, window: Window) -> _Answer:
        """Have the newest frame looked at, and with four frames the forecast computed."""
        service = self._service
        await check_access(self._websocket, service)
        service.require_serving()
        try:
            if len(window) < OBSERVED_FRAMES:
                await awaited(
                    self._timeout_s,
                    lambda token: service.inference.submit(FrameCheck(window, token), token),
                )
                return _Answer("collecting")
            content = await awaited(
                self._timeout_s,
                lambda token: service.inference.submit(
                    WindowForecast(self._request, window, token, service.registry, service.metrics),
                    token,
                ),
            )
        finally:
            with suppress(BodyTooLargeError, TooManyBodiesError):
                self._count_bytes()
        return _Answer("forecast", f',"forecast":{content}')

    def _restart_after(self, error: Exception, window: Window) -> None:
        """Begin a new window after a frame at fault: the others are no longer evenly spaced."""
        faults = error.field_errors if isinstance(error, ServiceError) else ()
        for frame in window:
            if faults and faults[0].field == frame.field:
                self._window = [kept for kept in self._window if kept.tick > frame.tick]

    def _refused(self, error: Exception) -> _Answer:
        if isinstance(error, ServiceError):
            self._service.metrics.refusal(error.slug)
        else:
            log.error("a tick of a session failed", exc_info=error)
        return _Answer("refused", f',"problem":{document(error)}')

    async def _send(self, tick: _Tick, answer: _Answer) -> None:
        latency_ms = 1e3 * (time.perf_counter() - tick.received)
        if tick.number:
            self._service.metrics.tick(answer.status)
        await self._websocket.send_text(
            f'{{"tick":{tick.number},"status":"{answer.status}",'
            f'"latency_ms":{latency_ms:.3f}{answer.part}}}'
        )
