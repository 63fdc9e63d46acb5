"""The server process: how it starts listening, and how it stops without losing an answer."""

import asyncio
import socket
from functools import partial

import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.connections import Connection
from service.loading import Loader
from service.logs import configuration
from service.settings import Settings
from service.state import State

POLL_S = 0.02


class Server(uvicorn.Server):
    """Uvicorn, told to stop, that answers first what it has accepted (SIGTERM, SIGINT).

    Readiness turns false at once, and new forecasts are refused with 503; the listener stays open
    until nothing is being computed, so that whoever asks can see that. A second signal ends the
    wait.
    """

    def __init__(self, app: FastAPI, settings: Settings) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=partial(  # pyright: ignore[reportArgumentType]
                    Connection, settings=settings, stopping=lambda: self.should_exit
                ),
                log_config=configuration(settings.log_format),
                access_log=False,  # service.logs has its own
                server_header=False,
                timeout_graceful_shutdown=settings.stop_timeout_s,
            )
        )
        self._app = app
        self._settings = settings

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


def serve(settings: Settings, listener: socket.socket, load: Loader) -> None:
    """Serve the models of a loader on a listening socket until told to stop."""
    # Inherited by every connection; asyncio leaves it out for a listener that it has not made,
    # and answers then wait 40 ms for an acknowledgement.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    Server(create_app(settings, load), settings).run(sockets=[listener])
