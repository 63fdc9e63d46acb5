"""``WebSocket /stream``: one frame a tick in, a forecast for the newest one out."""

from fastapi import APIRouter, WebSocket

from service.http.authorization import check_origin
from service.http.session import ForecastSession
from service.http.timeout import timeout_s
from service.state import ServiceState

router = APIRouter(tags=["forecast"])


@router.websocket("/stream")
async def stream(websocket: WebSocket, service: ServiceState) -> None:
    """Forecast for every frame of a loop; the service keeps the last four.

    Refused before the handshake, a session is answered with a problem document over HTTP.
    """
    check_origin(websocket, service.settings.allowed_origins)
    service.require_serving()
    session = ForecastSession(websocket, service, timeout_s(websocket, service.settings))
    await websocket.accept()
    await session.run()
