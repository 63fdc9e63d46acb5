"""``GET /``: a page that names the endpoints."""

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

PAGE = Path(__file__).resolve().parents[1] / "static" / "index.html"

router = APIRouter(include_in_schema=False)


@router.get("/")
async def home() -> FileResponse:
    """Return the page."""
    return FileResponse(PAGE, media_type="text/html")
