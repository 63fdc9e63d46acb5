"""The server process: how it starts listening, and how it stops without losing an answer."""

import asyncio
import socket
from functools import partial
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI

from service import model_reload
from service.app import create_app
from service.observability.log_config import configuration
from service.process.connection_limits import Connection
from service.serving.loading import Loader
from service.settings import Settings
from service.siblings import Service, Siblings
from service.state import State

POLL_S = 0.02


class Server(uvicorn.Server):
    """Uvicorn, told to stop, that answers first what it has accepted (SIGTERM, SIGINT).

    Readiness turns false at once, and new forecasts are refused with 503; the listener stays open
    until nothing is being computed, so that whoever asks can see that. A second signal ends the
    wait. One of several processes does not listen, but takes connections over.
    """

    def __init__(self, app: FastAPI, settings: Settings, siblings: Siblings | None = None) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=partial(  # pyright: ignore[reportArgumentType]
                    Connection,
                    settings=settings,
                    stopping=lambda: self.should_exit,
                    ended=_nothing if siblings is None else siblings.closed,
                ),
                log_config=configuration(settings.log_format, settings.log_requests),
                access_log=False,  # service.observability.log_config has its own
                server_header=False,
                proxy_headers=False,  # the app reads those of trusted proxies
                timeout_graceful_shutdown=settings.stop_timeout_s,
            )
        )
        self._app = app
        self._settings = settings
        self._siblings = siblings

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen, or to take connections over."""
        await super().startup(sockets)
        if self._siblings is not None:
            change = partial(model_reload.change_here, self._app.state.service)
            self._siblings.listen(Service(self._take_over, change, self._end))

    async def _take_over(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        await asyncio.get_running_loop().connect_accepted_socket(self._protocol, connection)

    def _protocol(self) -> asyncio.Protocol:
        given: dict[str, Any] = {
            "config": self.config,
            "server_state": self.server_state,
            "app_state": self.lifespan.state,
        }
        return self.config.http_protocol_class(**given)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Take no more from the signal on: others that answer are told at the same moment."""
        super().handle_exit(sig, frame)
        state: State | None = getattr(self._app.state, "service", None)
        if state is not None:  # it has none before it has begun
            state.phase = "draining"

    def _end(self) -> None:
        self.should_exit = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain, then close."""
        state: State = self._app.state.service
        state.phase = "draining"
        loop = asyncio.get_running_loop()
        asked = loop.time()
        while not self.force_exit and loop.time() < asked + self._settings.stop_timeout_s:
            if state.idle and loop.time() >= asked + self._settings.drain_s:
                break
            await asyncio.sleep(POLL_S)
        await super().shutdown(sockets)


def serve(settings: Settings, load: Loader, source: socket.socket | Siblings) -> None:
    """Serve the models of a loader until told to stop.

    Parameters
    ----------
    source
        Where connections come from: a listening socket, or what hands them over.
    """
    siblings = source if isinstance(source, Siblings) else None
    sockets = [] if isinstance(source, Siblings) else [source]
    Server(create_app(settings, load, siblings), settings, siblings).run(sockets)


def _nothing() -> None:
    """Do nothing."""
