"""``GET /metrics``: figures for Prometheus."""

from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.observability.metrics import PATH
from service.state import ServiceState

router = APIRouter(include_in_schema=False)


@router.get(PATH)
async def metrics(service: ServiceState) -> Response:
    """Return all figures in Prometheus' text format."""
    return Response(service.metrics.text(), media_type=CONTENT_TYPE_LATEST)
