"""``GET /models``: the served models, and the rejected ones with their reasons."""

from fastapi import APIRouter

from rollcast.schemas import ModelDetail, ModelEntry, ModelList, ModelMetrics, ModelSetup
from service.http.openapi import problems_of
from service.serving.registry import Model, Registry
from service.state import ServiceState

router = APIRouter(prefix="/models", tags=["models"])


@router.get("", responses=problems_of(401, 403))
async def list_models(service: ServiceState) -> ModelList:
    """List every version of every model."""
    return ModelList(models=[_entry(model) for model in service.registry.models])


@router.get("/{name}", responses=problems_of(401, 403, 404))
async def model_by_name(name: str, service: ServiceState) -> ModelDetail:
    """Return the default version of a model, with its card."""
    return _detail(service.registry.get(name), service.registry)


@router.get("/{name}/versions/{version}", responses=problems_of(401, 403, 404, 422))
async def model_by_version(name: str, version: int, service: ServiceState) -> ModelDetail:
    """Return one version of a model, with its card."""
    return _detail(service.registry.get(name, version), service.registry)


def _entry(model: Model) -> ModelEntry:
    manifest = model.manifest
    status = model.status
    if manifest is None:
        return ModelEntry(
            name=model.name, version=model.version, status=status, reason=model.reason
        )
    return ModelEntry(
        name=model.name,
        version=model.version,
        default=manifest.default,
        variant=manifest.variant,
        preset=manifest.preset,
        scenarios=list(manifest.scenarios),
        objects=manifest.objects,
        max_objects=manifest.max_objects,
        frame_rate_hz=manifest.frame_rate_hz,
        frame_rates_hz=manifest.frame_rates_hz,
        setup=None if manifest.setup is None else ModelSetup(**manifest.setup.model_dump()),
        frames=manifest.frames,
        final_step=manifest.final_step,
        trained_horizon=manifest.trained_horizon,
        covariance_source=manifest.covariance.source,
        angular_velocity=manifest.angular_velocity,
        status=status,
        reason=model.reason,
        metrics=ModelMetrics(
            validation_error_px=manifest.validation_error_px,
            rows=[row.model_dump(mode="json") for row in manifest.metrics],
        ),
    )


def _detail(model: Model, registry: Registry) -> ModelDetail:
    return ModelDetail(
        **dict(_entry(model)),
        versions=[other.version for other in registry.versions(model.name)],
        licence=None if model.manifest is None else model.manifest.licence,
        card=model.card,
    )
