"""Headers that every answer carries: what a browser may do with it, and who may read it."""

from collections.abc import Mapping

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rollcast.http import REPLICA_HEADER, REQUEST_ID_HEADER
from service.tensors import LENGTH_HEADER
from service.waiting import TIMEOUT_HEADER

ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
NOTHING_RUNS = "default-src 'none'; frame-ancestors 'none'"
"""Policy of an answer that has none of its own: data, which no browser need run."""
DESCRIPTION = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""Policy of ``/docs``, which begins with a script in the page."""
POLICY = "Content-Security-Policy"


def _raw(headers: Mapping[str, str]) -> dict[bytes, bytes]:
    """Return headers as messages of ASGI have them."""
    return {name.lower().encode(): value.encode() for name, value in headers.items()}


POLICY_OF_DATA = _raw({POLICY: NOTHING_RUNS})
POLICY_OF_PAGES = _raw({POLICY: DESCRIPTION})


class SecurityHeaders:
    """Adds the headers to every answer of an app."""

    def __init__(self, app: ASGIApp, origins: tuple[str, ...]) -> None:
        self._app = app
        resources = {"Cross-Origin-Resource-Policy": "cross-origin" if origins else "same-origin"}
        self._always = _raw(ALWAYS | resources)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the app does."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = dict(message["headers"])
                is_page = given.get(b"content-type", b"").startswith(b"text/html")
                added = self._always | (POLICY_OF_PAGES if is_page else POLICY_OF_DATA)
                own = [(name, value) for name, value in added.items() if name not in given]
                message = {**message, "headers": [*message["headers"], *own]}
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
