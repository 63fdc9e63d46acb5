"""Who may ask the service for what, and how often (decisions 0123 and 0127)."""

from fastapi import Request

from service.auth.api_keys import ApiKeyStore, Key, Scope
from service.errors import ForbiddenError, UnauthorizedError
from service.http.problem_details import PROTOCOL_PATH
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
"""Routes that ask nobody for a key: the page, the description, and what watches over the process.
`/openapi.json` and static files are no routes of FastAPI's and ask nobody either."""
MANAGING_PATH = f"{PROTOCOL_PATH}/repository/models/"


def scope_for(path: str) -> Scope | None:
    """Return the scope that a route needs; None where no key is needed."""
    if path in OPEN_PATHS:
        return None
    if path == "/metrics":
        return "metrics"
    return "manage" if path.startswith(MANAGING_PATH) else "forecast"


async def check_access(request: Request, service: ServiceState) -> None:
    """Let a request pass that may; every route asks this first.

    Raises
    ------
    UnauthorizedError
        Without a key that is known and has not expired.
    ForbiddenError
        With a key that lacks the scope.
    TooManyRequestsError
        When whoever asks has asked too often.
    """
    # The route's own path: what a proxy puts before it does not matter.
    scope = scope_for(request.scope["route"].path)
    if scope is None:
        return
    asker = request.client.host if request.client else "somebody"
    if service.api_keys is not None:
        asker = _key(request, service.api_keys, scope).name
    if service.rate_limiter is not None and scope != "metrics":
        service.rate_limiter.hit(asker)


def _key(request: Request, api_keys: ApiKeyStore, scope: Scope) -> Key:
    """Return the key of a request, if it has the scope."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer" or not token:
        raise UnauthorizedError("This needs an API key: Authorization: Bearer KEY.")
    key = api_keys.find(token.strip())
    if key is None:
        raise UnauthorizedError("This API key is not known, or has expired.")
    if scope not in key.scopes:
        raise ForbiddenError(
            f"API key {key.name!r} lacks scope {scope!r} (has: {', '.join(map(repr, key.scopes))})."
        )
    return key
