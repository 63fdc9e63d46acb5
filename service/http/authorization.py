"""Who may ask the service for what, and how often (decisions 0123 and 0127)."""

from fastapi import Request

from service.auth.api_keys import ApiKeyStore, Key, Right
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


def right_for(path: str) -> Right | None:
    """Return the right that a route needs; None where everybody may ask."""
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
        With one that has not the right.
    TooManyRequestsError
        When whoever asks has asked too often.
    """
    # The route's own path: what a proxy puts before it does not matter.
    right = right_for(request.scope["route"].path)
    if right is None:
        return
    asker = request.client.host if request.client else "somebody"
    if service.api_keys is not None:
        asker = _key(request, service.api_keys, right).name
    if service.rate_limiter is not None and right != "metrics":
        service.rate_limiter.hit(asker)


def _key(request: Request, api_keys: ApiKeyStore, right: Right) -> Key:
    """Return the key that a request shows, if it has the right."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer" or not token:
        raise UnauthorizedError("This needs an API key: Authorization: Bearer KEY.")
    key = api_keys.find(token.strip())
    if key is None:
        raise UnauthorizedError("This API key is not known, or has expired.")
    if right not in key.rights:
        raise ForbiddenError(
            f"The key {key.name} may not do this: it needs the right {right!r} and has "
            f"{', '.join(map(repr, key.rights))}."
        )
    return key
