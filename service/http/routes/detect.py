"""``POST /detect``: four frames in, the balls that are seen in them out."""

from fastapi import APIRouter, Request, Response

from rollcast.schemas import DetectRequest, DetectResponse
from service.http.detection import Detection
from service.http.openapi import body_of
from service.http.request_body import JSON, MULTIPART, Parser
from service.http.routes.predict import PROBLEMS, answer_frames
from service.inference.deadlines import CancellationToken
from service.inference.scheduler import Job
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

    def detection(parse: Parser[DetectRequest], token: CancellationToken) -> Job[str]:
        return Detection(parse, token, service.registry)

    return await answer_frames(request, service, DetectRequest, detection)
