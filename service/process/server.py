"""The server process: how it starts listening, and how it stops without losing an answer."""

import asyncio
import faulthandler
import socket
import time
from collections.abc import Callable
from functools import partial
from types import FrameType

import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.observability.log_config import configuration
from service.process.connection_limits import Connection, WebSocketConnection
from service.serving.loading import Loader
from service.serving.model_changes import ModelChanges
from service.settings import SHUTDOWN_MARGIN_S, Settings
from service.state import AppState

POLL_S = 0.02
PING_S = 20.0
"""Longest interval of a session's pings, and time for their answer."""


class Server(uvicorn.Server):
    """Uvicorn server that answers accepted requests before it stops (SIGTERM, SIGINT).

    Readiness turns false at once, and new forecasts are refused with 503; the listener stays open
    until nothing is being computed, so that clients can observe that. A second signal ends the
    wait. A thread that still computes shortly after the stop timeout, whatever it computes, ends
    with the process: its traceback goes to the standard error, and the exit code is 1.
    """

    def __init__(self, app: FastAPI, settings: Settings, on_start: Callable[[], object]) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=partial(  # pyright: ignore[reportArgumentType]
                    Connection, settings=settings, stopping=lambda: self.should_exit
                ),
                ws=partial(  # pyright: ignore[reportArgumentType]
                    WebSocketConnection,
                    settings=settings,
                    bodies=lambda: app.state.service.bodies,
                ),
                ws_max_size=settings.max_body_bytes,
                # Images are compressed already, and compressing answers would delay them.
                ws_per_message_deflate=False,
                ws_ping_interval=min(PING_S, settings.write_timeout_s),
                ws_ping_timeout=min(PING_S, settings.write_timeout_s),
                log_config=configuration(settings.log_format, settings.log_requests),
                access_log=False,  # service.observability.log_config has its own
                server_header=False,
                proxy_headers=False,  # the app reads those of trusted proxies
            )
        )
        self._app = app
        self._settings = settings
        self._on_start = on_start
        self._told_at: float | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept connections and report it; a process that cannot start ends."""
        try:
            await super().startup(sockets)
        except SystemExit:  # would wait for threads that the app has started
            faulthandler.dump_traceback_later(SHUTDOWN_MARGIN_S, exit=True)
            raise
        self._on_start()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Accept no more work after the signal; all workers get it at the same time."""
        super().handle_exit(sig, frame)
        if self._told_at is not None:
            self.force_exit = True
            return
        self._told_at = time.monotonic()
        # In C, so that neither the interpreter's lock nor a full event loop delays it.
        faulthandler.dump_traceback_later(
            self._settings.graceful_shutdown_timeout_s + SHUTDOWN_MARGIN_S, exit=True
        )
        state: AppState | None = getattr(self._app.state, "service", None)
        if state is not None:  # it has none before it has begun
            state.phase = "draining"

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain, then close."""
        state: AppState = self._app.state.service
        state.drain()
        begun = time.monotonic()
        ends = (self._told_at or begun) + self._settings.graceful_shutdown_timeout_s
        while not self.force_exit and time.monotonic() < ends:
            if state.idle and time.monotonic() >= begun + self._settings.shutdown_delay_s:
                break
            await asyncio.sleep(POLL_S)
        left = max(0.0, ends - time.monotonic())
        self.config.timeout_graceful_shutdown = left  # pyright: ignore[reportAttributeAccessIssue]
        await super().shutdown(sockets)


def make_server(
    settings: Settings,
    load: Loader,
    changes: ModelChanges | None = None,
    on_start: Callable[[], object] = lambda: None,
) -> uvicorn.Server:
    """Return the server of one process.

    Parameters
    ----------
    settings
        This process's share of the settings.
    load
        Loads its models.
    changes
        Loads and unloads that the other worker processes follow too, if there are any.
    on_start
        Called when the server accepts connections.
    """
    return Server(create_app(settings, load, changes), settings, on_start)
