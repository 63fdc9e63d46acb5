"""``/v2/repository``: the Open Inference Protocol's extension to load and unload models."""

from fastapi import APIRouter, Response, status

from service import model_reload
from service.http.oip.schemas import PROTOCOL_PATH, IndexEntry
from service.http.openapi import errors_of
from service.state import ServiceState

router = APIRouter(prefix=f"{PROTOCOL_PATH}/repository", tags=["open inference protocol"])


@router.post("/index", responses=errors_of(401, 403))
async def index(service: ServiceState) -> list[IndexEntry]:
    """List every version of every model."""
    return [
        IndexEntry(
            name=model.name,
            version=str(model.version),
            state="READY" if model.status == "ready" else "UNAVAILABLE",
            reason=model.reason or ("unloaded" if model.status == "unloaded" else ""),
        )
        for model in service.registry.models
    ]


@router.post(
    "/models/{name}/load", response_class=Response, responses=errors_of(400, 401, 403, 404, 503)
)
async def load(name: str, service: ServiceState) -> Response:
    """Load every version of a model again from its folder; 400 when one of them is refused."""
    service.require_serving()
    await model_reload.change(service, "load", name)
    return Response(status_code=status.HTTP_200_OK)


@router.post(
    "/models/{name}/unload", response_class=Response, responses=errors_of(401, 403, 404, 503)
)
async def unload(name: str, service: ServiceState) -> Response:
    """Stop serving a model; forecasts that have begun are answered."""
    service.require_serving()
    await model_reload.change(service, "unload", name)
    return Response(status_code=status.HTTP_200_OK)
