"""Security headers of all responses."""

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rollcast.schemas import REPLICA_HEADER, REQUEST_ID_HEADER
from service.http.oip.tensors import LENGTH_HEADER
from service.http.timeout import TIMEOUT_HEADER

ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
PERMISSIONS = "Permissions-Policy"
NO_DEVICES = "camera=(), display-capture=(), geolocation=(), microphone=()"
"""Permissions policy of all answers but the demo page, which opens a camera on request."""
NOTHING_RUNS = "default-src 'none'; frame-ancestors 'none'"
"""Policy of an answer that has none of its own: data, which no browser need run."""
DESCRIPTION = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""Policy of ``/docs``, which begins with a script in the page."""
POLICY = "Content-Security-Policy"


class SecurityHeaders:
    """Adds the headers to every answer of an app."""

    def __init__(self, app: ASGIApp, origins: tuple[str, ...]) -> None:
        self._app = app
        self._always = ALWAYS | {
            "Cross-Origin-Resource-Policy": "cross-origin" if origins else "same-origin"
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the app does."""

        async def with_headers(message: Message) -> None:
            # A refused WebSocket is answered as a request is.
            if message["type"].removeprefix("websocket.") == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in self._always.items():
                    headers.setdefault(name, value)
                headers.setdefault(PERMISSIONS, NO_DEVICES)
                is_page = headers.get("content-type", "").startswith("text/html")
                headers.setdefault(POLICY, DESCRIPTION if is_page else NOTHING_RUNS)
            await send(message)

        await self._app(scope, receive, with_headers)


def install_headers(app: FastAPI, origins: tuple[str, ...]) -> None:
    """Add the headers, and let pages of other origins read the answers if any are named."""
    if origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=origins,
            allow_methods=["GET", "POST"],
            allow_headers=[
                "Authorization", "Content-Type", LENGTH_HEADER, REQUEST_ID_HEADER, TIMEOUT_HEADER,
            ],
            expose_headers=[LENGTH_HEADER, REPLICA_HEADER, REQUEST_ID_HEADER, "Retry-After"],
        )  # fmt: skip
    app.add_middleware(SecurityHeaders, origins=origins)
