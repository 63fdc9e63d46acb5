"""``GET /``: the demo page, and its files below ``/static``."""

import os
from pathlib import Path

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import FileResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.types import Scope

from service.http.compression import compressed_file

STATIC = Path(__file__).resolve().parents[2] / "static"
PAGE = STATIC / "index.html"

CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "media-src 'self' blob: data:",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Content security policy: the page only loads files of this service and dropped files."""

PERMISSIONS_POLICY = "camera=(self), display-capture=(), geolocation=(), microphone=()"
"""Permissions policy: the page itself opens a camera, no frame in it does."""

REVALIDATED = {"Cache-Control": "no-cache"}
"""Cache policy: browsers revalidate files, so that files of two versions are not mixed."""

router = APIRouter(include_in_schema=False)


@router.get("/")
async def home(request: Request) -> Response:
    """Return the page."""
    headers = REVALIDATED | {
        "Content-Security-Policy": CONTENT_SECURITY_POLICY,
        "Permissions-Policy": PERMISSIONS_POLICY,
    }
    page = FileResponse(PAGE, media_type="text/html", headers=headers)
    return compressed_file(page, PAGE, request.scope)


def install_static_files(app: FastAPI) -> None:
    """Serve the page's scripts, styles and libraries."""
    app.mount("/static", _StaticFiles(directory=STATIC), name="static")


class _StaticFiles(StaticFiles):
    """Static files with revalidation (ETag)."""

    def file_response(
        self,
        full_path: "str | os.PathLike[str]",
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """Answer with a file, or that it has not changed."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers.update(REVALIDATED)
        return compressed_file(response, Path(full_path), scope)
