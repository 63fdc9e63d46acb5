"""Compressed answers, for clients that accept gzip."""

import gzip
from functools import lru_cache
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

SMALLEST_TEXT = 1024
"""Smallest description or document that is compressed, in bytes."""
SMALLEST_ANSWER = 64 * 1024
"""Smallest answer to a POST request that is compressed, in bytes. Forecasts of a usual horizon are
smaller: compression would delay control loops."""
COMPRESSIBLE = {".css", ".html", ".js", ".md", ".svg"}


class Compression:
    """Compresses the answers of an app; streams of events and pictures are left as they are."""

    def __init__(self, app: ASGIApp) -> None:
        self._texts = GZipMiddleware(app, minimum_size=SMALLEST_TEXT, compresslevel=6)
        # Numbers and base64 gain little from a higher level, which takes five times as long.
        self._answers = GZipMiddleware(app, minimum_size=SMALLEST_ANSWER, compresslevel=1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the app does."""
        compress = self._answers if scope.get("method") == "POST" else self._texts
        await compress(scope, receive, send)


def compressed_file(response: Response, path: Path, scope: Scope) -> Response:
    """Return the answer with a file compressed, if that is worth it and the client accepts it.

    Files are compressed once and kept: there are few, and every new visitor wants them.
    """
    headers = Headers(scope=scope)
    if path.suffix not in COMPRESSIBLE or response.status_code != 200 or "range" in headers:
        return response
    if "gzip" not in headers.get("accept-encoding", ""):
        response.headers.add_vary_header("Accept-Encoding")
        return response
    kept = MutableHeaders(raw=[*response.raw_headers])
    del kept["content-length"]
    kept["Content-Encoding"] = "gzip"
    kept.add_vary_header("Accept-Encoding")
    return Response(_compressed(path, path.stat().st_mtime_ns), headers=dict(kept))


@lru_cache(maxsize=128)
def _compressed(path: Path, changed_ns: int) -> bytes:  # noqa: ARG001 - a key of the cache
    return gzip.compress(path.read_bytes(), 9, mtime=0)
