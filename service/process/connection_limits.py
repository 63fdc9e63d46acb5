"""Limits of connections, for slow requests, unread responses and messages in many pieces.

Uvicorn has none of these limits: a request that never ends, or a response that the client does not
read, would hold a descriptor and memory until the client disconnects.
"""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import Frame

from service.errors import TooManyBodiesError
from service.inference.body_budget import BodyBudget, HeldBody
from service.observability.log_config import WEBSOCKET_LOGGER
from service.settings import Settings

MAX_HEAD_BYTES = 64 * 1024
"""Maximum bytes of a request line and its headers, if they arrive in several pieces."""
OVERHEAD_RATIO = 8
"""Framing bytes (chunk lengths, trailers) allowed per body byte, beyond those of a head.

A chunk of one byte has five."""
MAX_UNREAD_PONGS = 100
"""Pings that are answered while a WebSocket client reads nothing."""
PIECE_OVERHEAD = 64
"""Bytes of memory that a piece of a message takes beside its content."""
MESSAGE_MARGIN = 2**20
"""Bytes of overhead allowed for the pieces of one message."""
TRY_AGAIN_LATER = 1013
MESSAGE_TOO_BIG = 1009
CHECKS = 4
"""Checks of a connection before its time is over."""


class _TimeLimits:
    """Aborts a connection whose client sends or reads too slowly.

    Parameters
    ----------
    loop
        The event loop.
    transport
        Returns the connection's transport.
    settings
        The limits.
    is_paused
        Returns whether the application reads nothing; the client's time stands still then.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        transport: Callable[[], asyncio.Transport],
        settings: Settings,
        is_paused: Callable[[], bool],
    ) -> None:
        self._loop, self._transport, self._is_paused = loop, transport, is_paused
        self._read_s, self._write_s = settings.read_timeout_s, settings.write_timeout_s
        self.interval = min(self._read_s, self._write_s) / CHECKS
        """Time between two checks, seconds."""
        self.awaited_since: float | None = None
        """Time from which on the client is waited for; None if it need send nothing."""
        self._unread_bytes = 0
        self._read_at = loop.time()
        self._check_again = loop.call_later(self.interval, self._check)

    def read(self) -> None:
        """Note that the client reads."""
        self._read_at = self._loop.time()

    def stop(self) -> None:
        """Check no more."""
        self._check_again.cancel()

    def _check(self) -> None:
        now = self._loop.time()
        if self._is_paused() and self.awaited_since is not None:
            self.awaited_since = now
        unread = self._transport().get_write_buffer_size()
        if unread < self._unread_bytes or not unread:
            self._read_at = now
        self._unread_bytes = unread
        late = self.awaited_since is not None and now > self.awaited_since + self._read_s
        if late or now > self._read_at + self._write_s:
            self._transport().abort()
        else:
            self._check_again = self._loop.call_later(self.interval, self._check)


class Connection(HttpToolsProtocol):
    """Uvicorn's own, with limits.

    Parameters
    ----------
    settings
        Its limits.
    stopping
        Whether the service has been told to stop: a client that then kept its connection would send
        its next request into one that is being closed.
    """

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        settings: Settings,
        stopping: Callable[[], bool],
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._stopping = stopping
        self._time = _TimeLimits(
            self.loop, lambda: self.transport, settings, lambda: self.flow.read_paused
        )
        self._head_bytes: int | None = None
        self._framing = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Await the first request."""
        super().connection_made(transport)
        self._time.awaited_since = self.loop.time()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the checks."""
        self._time.stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read; empty lines between two requests begin one too."""
        self._framing += len(data)
        super().data_received(data)
        if self._framing > MAX_HEAD_BYTES + len(data):
            self.transport.abort()
            return
        self._framing = max(self._framing, 0)
        if self._head_bytes is not None:
            self._head_bytes += len(data)
            if self._head_bytes > MAX_HEAD_BYTES:
                self.transport.abort()
        cycle = self.cycle  # before its first request it has none
        idle = cycle is None or cycle.response_complete  # pyright: ignore[reportUnnecessaryComparison]
        if idle and self._time.awaited_since is None:
            self._time.awaited_since = self.loop.time()

    def on_message_begin(self) -> None:
        """Note when a request begins."""
        super().on_message_begin()
        self._time.awaited_since = self.loop.time()
        self._head_bytes = 0

    def on_headers_complete(self) -> None:
        """Give the body its own time, and the app a chance to refuse it by name."""
        super().on_headers_complete()
        cycle = self.cycle  # an upgrade to a WebSocket has none
        if cycle is not None and self._stopping():  # pyright: ignore[reportUnnecessaryComparison]
            cycle.keep_alive = False
        self._time.awaited_since = self.loop.time() + self._time.interval
        self._head_bytes = None
        self._framing = 0

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection over; a ``WebSocketConnection`` has limits of its own."""
        self._time.stop()
        super().handle_websocket_upgrade()

    def on_body(self, body: bytes) -> None:
        """Count framing bytes: the parser keeps trailers and chunk extensions in memory."""
        super().on_body(body)
        self._framing -= (1 + OVERHEAD_RATIO) * len(body)

    def on_message_complete(self) -> None:
        """Await nothing more."""
        super().on_message_complete()
        self._time.awaited_since = None

    def resume_writing(self) -> None:
        """Note that the client takes its answer."""
        super().resume_writing()
        self._time.read()


class WebSocketConnection(WebSocketsSansIOProtocol):
    """Uvicorn's own, with limits.

    Parameters
    ----------
    settings
        Its limits.
    bodies
        Returns the budget of bodies, in which messages count while they arrive.
    """

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        settings: Settings,
        bodies: Callable[[], BodyBudget],
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.logger = logging.getLogger(WEBSOCKET_LOGGER)
        self._bodies = bodies()
        self._held = HeldBody()
        self._held.give_up = lambda: self._fail(TRY_AGAIN_LATER, "too many messages in memory")
        self._time = _TimeLimits(
            self.loop, lambda: self.transport, settings, lambda: self.read_paused
        )
        self._pieces_bytes = 0
        """Bytes of the finished pieces of an unfinished message, with their overhead."""
        self._unread_pongs = 0

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the checks, and release the bytes of an unfinished message."""
        self._time.stop()
        self._bodies.resize(self._held, 0)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read, and count the bytes of the message that arrives."""
        super().data_received(data)
        if self.transport.is_closing():
            return
        arriving = len(self.conn.reader.buffer) + self._pieces_bytes
        if not arriving:
            self._time.awaited_since = None
        elif self._time.awaited_since is None:
            self._time.awaited_since = self.loop.time()
        if self._pieces_bytes > self.config.ws_max_size + MESSAGE_MARGIN:
            self._fail(MESSAGE_TOO_BIG, "a message in too many pieces")
            return
        try:
            self._bodies.resize(self._held, arriving)
        except TooManyBodiesError:
            self._fail(TRY_AGAIN_LATER, "too many messages in memory")

    def handle_cont(self, event: Frame) -> None:
        """Count a further piece."""
        self._pieces_bytes += len(event.data) + PIECE_OVERHEAD
        super().handle_cont(event)

    def handle_text(self, event: Frame) -> None:
        """Count the first piece."""
        self._pieces_bytes = len(event.data) + PIECE_OVERHEAD
        super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        """Count the first piece."""
        self._pieces_bytes = len(event.data) + PIECE_OVERHEAD
        super().handle_bytes(event)

    def send_receive_event_to_app(self) -> None:
        """Hand a message over, which the session counts from now on."""
        self._pieces_bytes = 0
        self._time.awaited_since = None
        super().send_receive_event_to_app()

    def handle_ping(self) -> None:
        """Answer, unless the client reads no answers."""
        super().handle_ping()
        self._unread_pongs = 0 if self.writable.is_set() else self._unread_pongs + 1
        if self._unread_pongs > MAX_UNREAD_PONGS:
            self.transport.abort()

    def _fail(self, code: int, reason: str) -> None:
        """Close the connection at once."""
        if not self.handshake_complete or self.close_sent:
            self.transport.abort()
            return
        self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": reason})
        self.conn.fail(code, reason)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.transport.close()
