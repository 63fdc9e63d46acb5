"""``POST /predict`` and ``/predict/stream``: four frames in, a forecast out."""

import logging
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import Future

from fastapi import APIRouter, Request, Response
from fastapi.sse import EventSourceResponse, format_sse_event

from rollcast.schemas import PredictRequest, PredictResponse, StreamDone, StreamStep
from service.errors import ServiceError
from service.http.openapi import body_of, problems_of
from service.http.prediction import StreamedForecast, WholeForecast
from service.http.problem_details import document
from service.http.request_body import (
    JSON,
    MULTIPART,
    Parser,
    R,
    media_type,
    parser_of,
    received,
)
from service.http.timeout import CLIENT_CLOSED_REQUEST, timeout_s
from service.inference.deadlines import CancellationToken, ClientGoneError, answered, streamed
from service.inference.scheduler import Job
from service.state import AppState, ServiceState

log = logging.getLogger(__name__)
router = APIRouter(tags=["forecast"])

PROBLEMS = problems_of(400, 401, 403, 404, 408, 413, 415, 422, 429, 503, 504)
EVENTS = "text/event-stream"


@router.post(
    "/predict",
    response_model=PredictResponse,
    responses=PROBLEMS,
    openapi_extra=body_of(PredictRequest, JSON, MULTIPART),
)
async def predict(request: Request, service: ServiceState) -> Response:
    """Forecast where the balls of four frames go, with angular velocities and covariances."""

    def forecast(parse: Parser[PredictRequest], token: CancellationToken) -> Job[str]:
        return WholeForecast(parse, token, service.registry, service.metrics)

    return await answer_frames(request, service, PredictRequest, forecast)


async def answer_frames(
    request: Request,
    service: AppState,
    model: type[R],
    job_of: Callable[[Parser[R], CancellationToken], Job[str]],
) -> Response:
    """Answer a body with frames by a job of the scheduler.

    Parameters
    ----------
    model
        Model of the body.
    job_of
        Factory of the job, whose result is JSON, from the parser of the body.
    """
    service.require_serving()
    kind = media_type(request, (JSON, MULTIPART))
    try:
        async with received(request) as body:
            parse = parser_of(model, kind, body, request)

            def submit(token: CancellationToken) -> Future[str]:
                return service.inference.submit(job_of(parse, token), token)

            content = await answered(request, timeout_s(request, service.settings), submit)
    except ClientGoneError:
        return Response(status_code=CLIENT_CLOSED_REQUEST)
    return Response(content, media_type=JSON)


@router.post(
    "/predict/stream",
    response_class=Response,  # declared as EventSourceResponse, FastAPI would take the route over
    responses={
        **PROBLEMS,
        200: {
            "description": "Server-sent events: a `step` for every step (StreamStep), then `done` "
            "(StreamDone), or `error` with a problem document.",
            "content": {EVENTS: {"schema": {"type": "string"}}},
        },
    },
    openapi_extra=body_of(PredictRequest, JSON, MULTIPART),
)
async def predict_stream(request: Request, service: ServiceState) -> Response:
    """Forecast as /predict does, and send every step as soon as it is there."""
    service.require_serving()

    def submit(
        token: CancellationToken, emit: Callable[[StreamStep | StreamDone], object]
    ) -> Future[None]:
        forecast = StreamedForecast(parse, token, service.registry, service.metrics, emit)
        return service.inference.submit(forecast, token)

    kind = media_type(request, (JSON, MULTIPART))
    async with received(request) as body:
        parse = parser_of(PredictRequest, kind, body, request)
        events = streamed(request, timeout_s(request, service.settings), submit)
        # Errors before the first step become problem documents, as those of /predict.
        first = await anext(events, None)
    return EventSourceResponse(_lines(first, events))


async def _lines(
    first: StreamStep | StreamDone | None, rest: AsyncGenerator[StreamStep | StreamDone]
) -> AsyncGenerator[bytes]:
    try:
        if first is not None:
            yield _event(first)
        async for event in rest:
            yield _event(event)
    except ClientGoneError:
        pass
    except Exception as error:
        if not isinstance(error, ServiceError):
            log.error("a stream failed", exc_info=error)
        yield format_sse_event(event="error", data_str=document(error))
    finally:
        await rest.aclose()


def _event(event: StreamStep | StreamDone) -> bytes:
    name = "done" if isinstance(event, StreamDone) else "step"
    return format_sse_event(event=name, data_str=event.model_dump_json())
