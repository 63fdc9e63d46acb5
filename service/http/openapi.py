"""OpenAPI descriptions of request bodies that the routes parse, and of error responses."""

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from rollcast.schemas import DetectRequest, PredictRequest, Problem, SimulateRequest
from service.http.oip.schemas import InferError, InferRequest, InferResponse
from service.http.problem_details import MEDIA_TYPE

REFERENCE = "#/components/schemas/{model}"
BODIES: Sequence[type[BaseModel]] = (
    PredictRequest,
    DetectRequest,
    SimulateRequest,
    Problem,
    InferRequest,
    InferResponse,
    InferError,
)
KEY = {"type": "http", "scheme": "bearer", "description": "An API key (decision 0123)."}
FRAMEWORK_SCHEMAS = ("HTTPValidationError", "ValidationError")


def body_of(model: type[BaseModel], *media_types: str) -> dict[str, Any]:
    """Describe the body of a route."""
    schema = {"$ref": REFERENCE.format(model=model.__name__)}
    content = {media_type: {"schema": schema} for media_type in media_types}
    return {"requestBody": {"required": True, "content": content}}


def problems_of(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe the refusals of a route."""
    content = {MEDIA_TYPE: {"schema": {"$ref": REFERENCE.format(model=Problem.__name__)}}}
    return {status: {"description": "Problem document", "content": content} for status in statuses}


def errors_of(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe the refusals of a route of the Open Inference Protocol."""
    # With a default, FastAPI adds no 422 of its own, which the protocol does not have.
    kinds: tuple[int | str, ...] = (*statuses, "default")
    return {status: {"description": "Error", "model": InferError} for status in kinds}


def tensors_of(model: type[BaseModel], follows: str) -> dict[str, Any]:
    """Describe a message of the protocol: JSON alone, or with binary tensors behind it."""
    binary = {"type": "string", "format": "binary", "description": follows}
    return {
        "application/json": {"schema": {"$ref": REFERENCE.format(model=model.__name__)}},
        "application/octet-stream": {"schema": binary},
    }


def _drop_unsent_refusals(schema: dict[str, Any]) -> None:
    """Drop FastAPI's own 422 wherever a route has not described one: it is never answered."""
    for name in FRAMEWORK_SCHEMAS:
        schema["components"]["schemas"].pop(name, None)
    for operations in schema["paths"].values():
        for operation in operations.values():
            refusal = operation["responses"].get("422", {})
            if "application/json" in refusal.get("content", {}):
                del operation["responses"]["422"]


def install_openapi(app: FastAPI) -> None:
    """Make the app describe itself with the bodies above."""

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(
                title=app.title,
                version=app.version,
                description=app.description,
                routes=app.routes,
            )
            _, bodies = models_json_schema(
                [(model, "validation") for model in BODIES], ref_template=REFERENCE
            )
            schema["components"]["schemas"] |= bodies["$defs"]
            schema["components"]["securitySchemes"] = {"key": KEY}
            schema["security"] = [{}, {"key": []}]  # asked for where keys are named
            _drop_unsent_refusals(schema)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = describe
