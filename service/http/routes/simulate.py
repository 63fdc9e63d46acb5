"""``POST /simulate``: a scene with its true path."""

from concurrent.futures.process import BrokenProcessPool

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool

from rollcast.errors import SceneParametersError, SceneRejectedError
from rollcast.schemas import SimulateRequest, SimulateResponse
from service.errors import (
    InvalidValueError,
    SceneRejectedProblem,
    SimulationLostError,
    SimulationMissingError,
)
from service.http.openapi import body_of, problems_of
from service.http.problem_details import in_plain_words
from service.http.request_body import JSON, media_type, parse_json, received
from service.http.timeout import CLIENT_CLOSED_REQUEST
from service.inference.deadlines import ClientGoneError, answered
from service.simulation.pool import is_installed, simulate
from service.state import ServiceState

MAX_BODY_BYTES = 64 * 1024
"""Bytes of a request; a whole scene that is posted back has a few thousand."""

NOT_INSTALLED = (
    "Simulations require PyBullet, which is not installed in the service's environment. Install "
    "the extra `simulation` and restart the service: `make serve PYTHON=/path/to/python3.11` "
    "installs it, `make serve SIMULATION=yes` compiles it on other versions. Forecasts do not "
    "require it."
)

router = APIRouter(tags=["simulation"])


@router.post(
    "/simulate",
    name="simulate",
    response_model=SimulateResponse,
    responses=problems_of(400, 401, 403, 408, 413, 415, 422, 429, 501, 503, 504),
    openapi_extra=body_of(SimulateRequest, JSON),
)
async def simulate_scene(request: Request, service: ServiceState) -> Response:
    """Simulate and draw a scene; the same seed gives the same bytes."""
    service.require_open()
    if not is_installed():
        raise SimulationMissingError(NOT_INSTALLED)
    media_type(request, (JSON,))
    async with received(request, MAX_BODY_BYTES) as text:
        body = await run_in_threadpool(parse_json, text, SimulateRequest)
    _check_pixels(body, service.settings.max_simulated_pixels)
    try:
        content = await answered(
            request, None, lambda token: service.simulation.submit(token, simulate, body)
        )
    except ClientGoneError:
        return Response(status_code=CLIENT_CLOSED_REQUEST)
    except SceneParametersError as error:
        expected = in_plain_words(error.expected)
        raise InvalidValueError.at(error.field, error.value, expected) from error
    except SceneRejectedError as error:
        raise SceneRejectedProblem.at("seed", body.seed, f"another one: {error}") from error
    except BrokenProcessPool as error:
        raise SimulationLostError(
            "The simulation process died or cannot be started; the next request starts a new one."
        ) from error
    return Response(content, media_type=JSON)


def _check_pixels(body: SimulateRequest, limit: int) -> None:
    if body.include_frames and body.steps * body.image_size**2 > limit:
        largest = limit // body.image_size**2
        expected = f"at most {largest} with frames of this size, or include_frames false"
        raise InvalidValueError.at("steps", body.steps, expected)
