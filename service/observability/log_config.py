"""Logs as one JSON object a line, each with the id of its request."""

import logging
import re
import time
from collections.abc import Callable
from typing import Any, Literal, TypeAlias
from urllib.parse import quote

from asgi_correlation_id import CorrelationIdMiddleware
from asgi_correlation_id.context import correlation_id
from fastapi import FastAPI
from pythonjsonlogger.json import JsonFormatter
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rollcast.schemas import REPLICA_HEADER, REQUEST_ID_HEADER
from service.auth.api_keys import without_tokens

Count: TypeAlias = Callable[[str, str, int, float], None]
"""Callback with the route's path, the method, the status and the seconds of a request."""

RESPONSE_STARTS = frozenset(
    {"http.response.start", "websocket.http.response.start", "websocket.accept"}
)
"""Messages of an application that begin a response."""
LONGEST_PATH = 1000
"""Characters of a path that a log line shows: a head may hold sixty times as many."""

access = logging.getLogger("service.http.authorization")
WEBSOCKET_LOGGER = "uvicorn.error.websocket"
"""Logger of WebSocket connections; their handshakes are in the access log already."""

_REQUEST_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")


class AccessLog:
    """Middleware that logs every request after its response, and every session at its end.

    A session counts as a request that its handshake answers with 101.

    Parameters
    ----------
    app
        The wrapped application.
    replica
        Name of this process among several, for the line and a header; "" where it is alone.
    count
        Callback for requests with a route.
    """

    def __init__(self, app: ASGIApp, replica: str, count: Count) -> None:
        self._app = app
        self._replica = replica
        self._count = count

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the app does."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        begun = time.perf_counter()
        status, answered_s = 500, None

        async def noted(message: Message) -> None:
            nonlocal status, answered_s
            if message["type"] in RESPONSE_STARTS:
                status = message.get("status", 101)
                if scope["type"] == "websocket":
                    answered_s = time.perf_counter() - begun
                    MutableHeaders(scope=message).setdefault(REQUEST_ID_HEADER, request_id() or "")
                if self._replica:
                    MutableHeaders(scope=message)[REPLICA_HEADER] = self._replica
            await send(message)

        try:
            await self._app(scope, receive, noted)
        finally:
            seconds = time.perf_counter() - begun
            if (route := scope.get("route")) is not None:
                method = scope.get("method", "GET")
                self._count(route.path, method, status, answered_s or seconds)
            if access.isEnabledFor(logging.INFO):
                self._write(scope, status, seconds)

    def _write(self, scope: Scope, status: int, seconds: float) -> None:
        parts = {
            "client": ":".join(map(str, scope["client"] or ())),
            "method": scope.get("method", "GET"),
            "path": quote(scope["path"][:LONGEST_PATH]),
            "status": status,
            "duration_ms": round(1e3 * seconds, 1),
        }
        if self._replica:
            parts["replica"] = self._replica
        access.info("%(method)s %(path)s: %(status)d in %(duration_ms)s ms", parts, extra=parts)


def install_access_log(app: FastAPI, replica: str, count: Count) -> None:
    """Log and count every request, and give it an id: the client's own where it sends a sound one.

    The id goes back in a header, and so does the name of the replica.
    """
    app.add_middleware(AccessLog, replica=replica, count=count)
    app.add_middleware(
        CorrelationIdMiddleware,
        header_name=REQUEST_ID_HEADER,
        validator=lambda text: _REQUEST_ID.fullmatch(text) is not None,
    )


def request_id() -> str | None:
    """Id of the request that is being answered."""
    return correlation_id.get()


class TextLines(logging.Formatter):
    """Writes a record as text, without API keys."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        return without_tokens(super().format(record))


class JsonLines(JsonFormatter):
    """Formatter for a record's time, level, logger, message, request and extra fields.

    API keys in any of these are cut to their prefix.
    """

    def __init__(self) -> None:
        super().__init__(  # pyright: ignore[reportUnknownMemberType]
            "{asctime}{levelname}{name}{message}",
            style="{",
            rename_fields={"asctime": "time", "levelname": "level", "name": "logger"},
        )
        self.default_msec_format = "%s.%03d"

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        return without_tokens(super().format(record))

    def add_fields(
        self, log_data: dict[str, Any], record: logging.LogRecord, message_dict: dict[str, Any]
    ) -> None:
        """Fill in the fields of a log line."""
        super().add_fields(log_data, record, message_dict)
        if (of_request := request_id()) is not None:
            log_data["request_id"] = of_request


def configuration(log_format: Literal["json", "text"], log_requests: bool) -> dict[str, Any]:
    """Return the configuration for ``logging.config.dictConfig``; output goes to stderr."""
    text = "%(asctime)s %(levelname)s %(name)s: %(message)s"
    formatter = {"()": JsonLines} if log_format == "json" else {"()": TextLines, "fmt": text}
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"lines": formatter},
        "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "lines"}},
        "loggers": {
            access.name: {"level": "INFO" if log_requests else "WARNING"},
            WEBSOCKET_LOGGER: {"level": "WARNING"},
        },
        "root": {"handlers": ["stderr"], "level": "INFO"},
    }
