"""Authorisation and rate limits of requests (decisions 0123 and 0127)."""

from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection

from service.auth.api_keys import ApiKeyStore, Key, Scope
from service.errors import ForbiddenError, OriginError, UnauthorizedError
from service.http.oip.schemas import PROTOCOL_PATH
from service.state import ServiceState

OPEN_PATHS = frozenset(
    {
        "/",
        "/docs",
        "/docs/oauth2-redirect",
        "/health/live",
        "/health/ready",
        f"{PROTOCOL_PATH}/health/live",
        f"{PROTOCOL_PATH}/health/ready",
    }
)
"""Routes without a key: the page, the API description and health checks.

`/openapi.json` and static files are not FastAPI routes and need no key either."""
MANAGING_PATH = f"{PROTOCOL_PATH}/repository/models/"


def scope_for(path: str) -> Scope | None:
    """Return the scope that a route needs; None where no key is needed."""
    if path in OPEN_PATHS:
        return None
    if path == "/metrics":
        return "metrics"
    return "manage" if path.startswith(MANAGING_PATH) else "forecast"


async def check_access(request: HTTPConnection, service: ServiceState) -> None:
    """Check the API key and the rate limit of a request; a dependency of every route.

    A session calls it for every forecast, too.

    Raises
    ------
    UnauthorizedError
        If the key is missing, unknown or expired.
    ForbiddenError
        If the key lacks the scope.
    TooManyRequestsError
        If the client exceeds its rate limit.
    """
    # The route's own path, without the prefix of a proxy.
    scope = scope_for(request.scope["route"].path)
    if scope is None:
        return
    client_name = request.client.host if request.client else "unknown"
    if service.api_keys is not None:
        client_name = _key(request, service.api_keys, scope).name
    if service.rate_limiter is not None and scope != "metrics":
        service.rate_limiter.hit(client_name)


def check_origin(connection: HTTPConnection, allowed: Collection[str]) -> None:
    """Check the web page that opens a WebSocket, which CORS does not cover.

    Programs send no ``Origin``. A page of the service has the host that the request names; its
    scheme is not compared, since a proxy may terminate TLS.

    Raises
    ------
    OriginError
        If the page is neither the service's own nor of an allowed origin.
    """
    origin = connection.headers.get("origin")
    if origin is None or "*" in allowed or origin in allowed:
        return
    if urlsplit(origin).netloc.lower() != connection.headers.get("host", "").lower():
        raise OriginError.at(
            "origin", origin, "an origin that ROLLCAST_ALLOWED_ORIGINS lists, or the service's own"
        )


def _key(request: HTTPConnection, api_keys: ApiKeyStore, scope: Scope) -> Key:
    """Return the key of a request, if it has the scope."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer" or not token:
        raise UnauthorizedError("An API key is required: Authorization: Bearer KEY.")
    key = api_keys.find(token.strip())
    if key is None:
        raise UnauthorizedError("The API key is unknown or has expired.")
    if scope not in key.scopes:
        raise ForbiddenError(
            f"API key {key.name!r} lacks scope {scope!r} (has: {', '.join(map(repr, key.scopes))})."
        )
    return key
