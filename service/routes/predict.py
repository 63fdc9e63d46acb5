"""``POST /predict``: four frames in, a forecast out."""

from fastapi import APIRouter, Request, Response

from rollcast.http import PredictRequest, PredictResponse
from service.bodies import JSON, MULTIPART, media_type, parse_json, read_body, read_form
from service.forecasts import answer
from service.openapi import body_of, problems_of
from service.registry import Registry
from service.state import ServiceState

router = APIRouter(tags=["forecast"])


@router.post(
    "/predict",
    response_model=PredictResponse,
    responses=problems_of(400, 404, 413, 415, 422, 429, 503),
    openapi_extra=body_of(PredictRequest, JSON, MULTIPART),
)
async def predict(request: Request, service: ServiceState) -> Response:
    """Forecast where the balls of four frames go, with angular velocities and covariances."""
    service.require_serving()
    if media_type(request, (JSON, MULTIPART)) == JSON:
        body = await read_body(request)
        content = await service.inference.run(_answer_json, body, service.registry)
    else:
        form = await read_form(request, PredictRequest, lists=frozenset({"frames"}))
        content = await service.inference.run(_answer, form, service.registry)
    return Response(content, media_type=JSON)


def _answer_json(body: bytes, registry: Registry) -> str:
    return _answer(parse_json(body, PredictRequest), registry)


def _answer(request: PredictRequest, registry: Registry) -> str:
    return answer(request, registry).model_dump_json()
