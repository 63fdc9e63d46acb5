"""The prefix below which a reverse proxy serves the app."""

from starlette.types import ASGIApp, Receive, Scope, Send


class RootPath:
    """Middleware that sets the path prefix, whether or not the proxy strips it.

    Parameters
    ----------
    app
        The wrapped application.
    prefix
        Path prefix such as ``/rollcast``.
    """

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app = app
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the app does."""
        if scope["type"] in {"http", "websocket"}:
            path: str = scope["path"]
            if not f"{path}/".startswith(f"{self._prefix}/"):
                path = self._prefix + path
            # In ASGI the path includes the root path.
            scope = {**scope, "root_path": self._prefix, "path": path}
        await self._app(scope, receive, send)
