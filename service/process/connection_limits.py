"""Time limits of connections, for slow requests and unread responses.

Uvicorn has neither limit: a request that never ends, or a response that the client does not
read, would hold a descriptor and memory until the client disconnects.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from service.settings import Settings

MAX_HEAD_BYTES = 64 * 1024
"""Maximum bytes of a request line and its headers, if they arrive in several pieces."""
OVERHEAD_RATIO = 8
"""Framing bytes (chunk lengths, trailers) allowed per body byte, beyond those of a head.

A chunk of one byte has five."""
LOOKS = 4
"""Times that a connection is looked at before its time is over."""


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
        self._receive_s = settings.read_timeout_s
        self._send_s = settings.write_timeout_s
        self._interval = min(self._receive_s, self._send_s) / LOOKS
        self._look_again: asyncio.TimerHandle | None = None
        self._awaited_since: float | None = None
        self._head_bytes: int | None = None
        self._framing = 0
        self._untaken = 0
        self._taken_at = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Await the first request."""
        super().connection_made(transport)
        self._awaited_since = self._taken_at = self.loop.time()
        self._look_again = self.loop.call_later(self._interval, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Look no more."""
        if self._look_again is not None:
            self._look_again.cancel()
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
        if idle and self._awaited_since is None:
            self._awaited_since = self.loop.time()

    def on_message_begin(self) -> None:
        """Note when a request begins."""
        super().on_message_begin()
        self._awaited_since = self.loop.time()
        self._head_bytes = 0

    def on_headers_complete(self) -> None:
        """Give the body its own time, and the app a chance to refuse it by name."""
        super().on_headers_complete()
        if self._stopping():
            self.cycle.keep_alive = False
        self._awaited_since = self.loop.time() + self._interval
        self._head_bytes = None
        self._framing = 0

    def on_body(self, body: bytes) -> None:
        """Count framing bytes: the parser keeps trailers and chunk extensions in memory."""
        super().on_body(body)
        self._framing -= (1 + OVERHEAD_RATIO) * len(body)

    def on_message_complete(self) -> None:
        """Await nothing more."""
        super().on_message_complete()
        self._awaited_since = None

    def resume_writing(self) -> None:
        """Note that the client takes its answer."""
        super().resume_writing()
        self._taken_at = self.loop.time()

    def _look(self) -> None:
        now = self.loop.time()
        if self.flow.read_paused and self._awaited_since is not None:
            self._awaited_since = now  # it is the app that does not read
        untaken = self.transport.get_write_buffer_size()
        if untaken < self._untaken or not untaken:
            self._taken_at = now
        self._untaken = untaken
        late = self._awaited_since is not None and now > self._awaited_since + self._receive_s
        if late or now > self._taken_at + self._send_s:
            self.transport.abort()
        else:
            self._look_again = self.loop.call_later(self._interval, self._look)
