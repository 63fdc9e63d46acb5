"""``/health``: is the process alive, does it answer forecasts."""

from fastapi import APIRouter, Response, status

from rollcast.schemas import Health
from service.state import ServiceState

router = APIRouter(prefix="/health", tags=["health"])


@router.get("/live")
async def live() -> Health:
    """Answer as long as the process runs."""
    return Health(status="live")


@router.get("/ready", responses={status.HTTP_503_SERVICE_UNAVAILABLE: {"model": Health}})
async def ready(service: ServiceState, response: Response) -> Health:
    """Answer 200 when forecasts are answered; 503 while loading, draining, or with no model."""
    readiness = service.readiness
    if readiness != "ready":
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return Health(status=readiness)
