"""``POST /detect``: four frames in, the balls that are seen in them out."""

from concurrent.futures import Future

from fastapi import APIRouter, Request, Response

from rollcast.schemas import DetectRequest, DetectResponse
from service.http.detection import Detection
from service.http.openapi import body_of
from service.http.request_body import JSON, MULTIPART, media_type, parser_of, received
from service.http.routes.predict import PROBLEMS
from service.inference.deadlines import (
    CLIENT_CLOSED_REQUEST,
    CancellationToken,
    ClientGoneError,
    answered,
    timeout_s,
)
from service.state import ServiceState

router = APIRouter(tags=["forecast"])


@router.post(
    "/detect",
    response_model=DetectResponse,
    responses=PROBLEMS,
    openapi_extra=body_of(DetectRequest, JSON, MULTIPART),
)
async def detect(request: Request, service: ServiceState) -> Response:
    """Find all balls in four frames, moving or not, without a forecast.

    Pictures that are wider than high, or the reverse, are looked at in several squares.
    """
    service.require_serving()
    kind = media_type(request, (JSON, MULTIPART))
    try:
        async with received(request) as body:
            parse = parser_of(DetectRequest, kind, body, request)

            def submit(token: CancellationToken) -> Future[str]:
                return service.inference.submit(Detection(parse, token, service.registry), token)

            content = await answered(request, timeout_s(request, service.settings), submit)
    except ClientGoneError:
        return Response(status_code=CLIENT_CLOSED_REQUEST)
    return Response(content, media_type=JSON)
