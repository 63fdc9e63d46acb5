"""``/v2``: the Open Inference Protocol over REST, with the binary tensor extension."""

from functools import partial
from math import prod

import numpy as np
from fastapi import APIRouter, Request, Response, status

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.rollout import Outputs, joined
from rollcast.schemas import API_VERSION
from service.http.oip.schemas import (
    PROTOCOL_PATH,
    InferRequest,
    InferResponse,
    ModelMetadata,
    ModelReady,
    ServerLive,
    ServerMetadata,
    ServerReady,
)
from service.http.oip.tensors import (
    LENGTH_HEADER,
    Message,
    Query,
    inputs_of,
    outputs_of,
    read_query,
    split,
    write_answer,
)
from service.http.openapi import errors_of, tensors_of
from service.http.request_body import JSON, MAX_VALUES, Body, parse_json, received
from service.http.timeout import CLIENT_CLOSED_REQUEST, timeout_s
from service.inference.ball_predictor import BallPredictor
from service.inference.deadlines import ClientGoneError, answered
from service.inference.rollout import Predictor, assemble
from service.inference.scheduler import DecodedRequest
from service.observability.tracing import Stages
from service.state import AppState, ServiceState

OCTETS = "application/octet-stream"
PLATFORM = "onnxruntime_onnx"

MODEL_ERRORS = errors_of(404, 503)
INFER_ANSWERS = {
    **errors_of(400, 401, 403, 404, 408, 413, 415, 429, 503, 504),
    200: {
        "description": f"Outputs. With binary outputs, {LENGTH_HEADER} is the length of the JSON.",
        "content": tensors_of(InferResponse, "InferResponse as JSON, then the binary outputs"),
    },
}
INFER_BODY = {
    "requestBody": {
        "required": True,
        "content": tensors_of(InferRequest, "InferRequest as JSON, then the binary inputs"),
    },
    "parameters": [
        {
            "name": LENGTH_HEADER,
            "in": "header",
            "description": "Length of the JSON when binary inputs follow it.",
            "schema": {"type": "integer", "minimum": 0},
        }
    ],
}

router = APIRouter(prefix=PROTOCOL_PATH, tags=["open inference protocol"])


@router.get("", responses=errors_of(401, 403))
async def server_metadata() -> ServerMetadata:
    """Return the server metadata."""
    extensions = ["binary_tensor_data", "model_repository"]
    return ServerMetadata(name="rollcast", version=API_VERSION, extensions=extensions)


@router.get("/health/live")
async def server_live() -> ServerLive:
    """Answer as long as the process runs."""
    return ServerLive(live=True)


@router.get(
    "/health/ready", responses={status.HTTP_503_SERVICE_UNAVAILABLE: {"model": ServerReady}}
)
async def server_ready(service: ServiceState, response: Response) -> ServerReady:
    """Answer 200 when forecasts are answered; 503 while loading, draining, or with no model."""
    ready = service.readiness == "ready"
    if not ready:
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return ServerReady(live=True, ready=ready)


@router.get("/models/{name}", responses=MODEL_ERRORS)
async def model_metadata(name: str, service: ServiceState) -> ModelMetadata:
    """Describe the tensors of a model's default version."""
    return _metadata(_predictor(service, name), service)


@router.get("/models/{name}/versions/{version}", responses=MODEL_ERRORS)
async def version_metadata(name: str, version: str, service: ServiceState) -> ModelMetadata:
    """Describe the tensors of one version of a model."""
    return _metadata(_predictor(service, name, version), service)


@router.get("/models/{name}/ready", responses=MODEL_ERRORS)
async def model_ready(name: str, service: ServiceState) -> ModelReady:
    """Answer 200 when the default version of a model answers forecasts."""
    return ModelReady(name=_predictor(service, name).manifest.name, ready=True)


@router.get("/models/{name}/versions/{version}/ready", responses=MODEL_ERRORS)
async def version_ready(name: str, version: str, service: ServiceState) -> ModelReady:
    """Answer 200 when one version of a model answers forecasts."""
    return ModelReady(name=_predictor(service, name, version).manifest.name, ready=True)


@router.post(
    "/models/{name}/infer",
    response_model=InferResponse,
    responses=INFER_ANSWERS,
    openapi_extra=INFER_BODY,
)
async def infer(name: str, request: Request, service: ServiceState) -> Response:
    """Forecast a batch with the default version of a model, in pixels of 128-pixel frames."""
    return await _infer(request, service, name)


@router.post(
    "/models/{name}/versions/{version}/infer",
    response_model=InferResponse,
    responses=INFER_ANSWERS,
    openapi_extra=INFER_BODY,
)
async def infer_by_version(
    name: str, version: str, request: Request, service: ServiceState
) -> Response:
    """Forecast a batch with one version of a model, in pixels of 128-pixel frames."""
    return await _infer(request, service, name, version)


def _predictor(service: AppState, name: str, version: str | None = None) -> Predictor:
    service.require_serving()
    return service.registry.predictor(name, version)


def _metadata(predictor: Predictor, service: AppState) -> ModelMetadata:
    manifest = predictor.manifest
    return ModelMetadata(
        name=manifest.name,
        versions=[str(model.version) for model in service.registry.versions(manifest.name)],
        platform=PLATFORM,
        inputs=inputs_of(manifest),
        outputs=outputs_of(manifest),
    )


async def _infer(
    request: Request, service: AppState, name: str, version: str | None = None
) -> Response:
    predictor = _predictor(service, name, version)
    try:
        async with received(request) as body:
            batch = Batch(body, request.headers.get(LENGTH_HEADER), predictor, service)
            message = await answered(
                request,
                timeout_s(request, service.settings),
                partial(service.inference.submit, batch),
            )
    except ClientGoneError:
        return Response(status_code=CLIENT_CLOSED_REQUEST)
    if message.json_length is None:
        return Response(message.content, media_type=JSON)
    headers = {LENGTH_HEADER: str(message.json_length)}
    return Response(message.content, headers=headers, media_type=OCTETS)


class Batch:
    """A batch of forecasts on its way through the scheduler."""

    _query: Query

    def __init__(
        self, body: Body, length: str | None, predictor: Predictor, service: AppState
    ) -> None:
        self._body = body
        self._length = length
        self._predictor = predictor
        self._service = service
        self._stages = Stages(service.metrics)
        self._parts: list[Outputs] = []

    def begin(self) -> DecodedRequest:
        """Parse the body."""
        self._stages.begin("decode")
        text, binary = split(self._body, self._length)
        most, manifest = self._service.settings.max_batch, self._predictor.manifest
        numbers = most * prod(manifest.frames_shape)
        # Nested as the shape says, lists of three numbers among them, it has half as many lists.
        request = parse_json(text, InferRequest, MAX_VALUES + numbers + numbers // 2)
        self._query = read_query(request, binary, manifest, most)
        self._stages.begin("encode")
        frames, points = self._query.frames, self._query.balls
        if points is None:
            return DecodedRequest(self._predictor, frames, self._query.horizon)
        predictor = self._predictor
        assert isinstance(predictor, BallPredictor)  # others have no such input
        prompts = 2 * points / NETWORK_FRAME_SIZE - 1
        found = [predictor.find(*each) for each in zip(frames, prompts, strict=True)]
        packed = np.concatenate([one.packed for one in found])
        return DecodedRequest(predictor.rollout(points.shape[1]), packed, self._query.horizon)

    def take(self, outputs: Outputs) -> None:
        """Keep steps' outputs."""
        if not self._parts:
            self._stages.begin("rollout")
        self._parts.append(outputs)

    def finish(self) -> Message:
        """Write the answer."""
        manifest = self._predictor.manifest
        self._stages.end(manifest.label)
        forecast = assemble(joined(self._parts), manifest.covariance)
        return write_answer(self._query, manifest, forecast)
