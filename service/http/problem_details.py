"""Conversion of exceptions to problem documents (RFC 9457).

Under ``/v2`` errors follow the Open Inference Protocol instead: an object with one field,
``error``, and the status 400 for invalid values.
"""

import json
import math
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, cast

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import JsonValue
from starlette.exceptions import HTTPException

from rollcast.schemas import FieldError, Problem
from service.errors import (
    InvalidField,
    InvalidValueError,
    ModelUnavailableError,
    NotReadyError,
    OutOfMemoryError,
    QueueFullError,
    ServiceError,
    SimulationLostError,
    TooManyBodiesError,
    TooManyRequestsError,
    UnauthorizedError,
)
from service.http.oip.schemas import PROTOCOL_PATH, InferError
from service.http.security_headers import ALWAYS, NOTHING_RUNS, POLICY
from service.observability.log_config import REQUEST_ID_HEADER, request_id

MEDIA_TYPE = "application/problem+json"
PASSING = (
    QueueFullError,
    NotReadyError,
    ModelUnavailableError,
    SimulationLostError,
    TooManyBodiesError,
    OutOfMemoryError,
)
"""Temporary errors, whose responses have a Retry-After header."""
RETRY_AFTER_S = 1
"""Seconds in that header, its minimum; a forecast takes a fraction of that."""
LONGEST_VALUE = 100
"""Characters of a wrong value that are sent back."""
LONGEST_DETAIL = 600
MAX_FIELD_ERRORS = 10
"""Wrong values that an answer names; there may be more."""
MOST_FAULTS = 4
"""Maximum number of invalid values in the text of a protocol error."""


def install_problem_handlers(app: FastAPI) -> None:
    """Make the app answer every refusal and every failure with a problem document."""
    for kind in (ServiceError, RequestValidationError, HTTPException, MemoryError, Exception):
        app.add_exception_handler(kind, _answer)


def document(error: Exception) -> str:
    """Return the problem document of a failure that comes too late for a status of its own."""
    return json.dumps(_members(_problem(error)))


def invalid_values(errors: Sequence[Any]) -> ServiceError:
    """Translate pydantic's list of errors, in which a model's own check names its field."""
    field_errors = [_field_error(error) for error in errors[:MAX_FIELD_ERRORS]]
    if len(field_errors) == 1:
        return InvalidValueError.at(
            field_errors[0].field, field_errors[0].value, field_errors[0].expected
        )
    fields = ", ".join(_shorten(field_error.field) for field_error in field_errors)
    beyond = len(errors) - len(field_errors)
    more = f" and {beyond} more" if beyond else ""
    return InvalidValueError(f"{len(errors)} values are invalid: {fields}{more}", field_errors)


def in_plain_words(message: str) -> str:
    """Remove pydantic's prefix of a reason."""
    return message.removeprefix("Input should be ").removeprefix("Value error, ")


def _field_error(error: Mapping[str, Any]) -> InvalidField:
    context: dict[str, Any] = error.get("ctx", {})
    if "field" in context:
        return InvalidField(context["field"], context["value"], context["expected"])
    expected = {
        "missing": "a value, the field is required",
        "extra_forbidden": "no such field",
        "too_short": f"{context.get('min_length')} items",
        "too_long": f"at most {context.get('max_length')} items",
        "model_type": "an object",
    }.get(error["type"], in_plain_words(error["msg"]))
    value = None if error["type"] == "missing" else _presentable(error["input"])
    return InvalidField(_path(error["loc"]), value, expected)


def _path(location: Sequence[int | str]) -> str:
    """Write ``("frames", 2)`` as ``frames[2]`` and ``("scene", "seed")`` as ``scene.seed``."""
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).removeprefix(".") or "body"


async def _answer(request: Request, error: Exception) -> Response:
    # Not a plain function: Starlette would call that in a thread, for which a service at its limits
    # may have no descriptor.
    headers: dict[str, str] = {}
    match error:
        case ServiceError():
            request.app.state.service.metrics.refusal(error.slug)
            problem = _problem(error)
            if isinstance(error, UnauthorizedError):
                headers["WWW-Authenticate"] = "Bearer"
            if isinstance(error, TooManyRequestsError):
                headers["Retry-After"] = str(error.retry_after_s)
            if isinstance(error, PASSING):
                headers["Retry-After"] = str(RETRY_AFTER_S)
        case MemoryError():
            return await _answer(request, _out_of_memory())
        case RequestValidationError():
            parameters = [fault | {"loc": fault["loc"][1:]} for fault in error.errors()]
            problem = _refusal(invalid_values(parameters))
        case HTTPException():
            problem = _http_problem(request, error)
            headers.update(error.headers or {})
        case _:
            problem = _problem(error)
            # The middleware that adds these headers does not see responses to unhandled errors.
            headers |= ALWAYS | {POLICY: NOTHING_RUNS}
            if (failed := request_id()) is not None:
                headers[REQUEST_ID_HEADER] = failed
    path = request.scope["path"].removeprefix(request.scope.get("root_path", ""))
    if f"{path}/".startswith(f"{PROTOCOL_PATH}/"):
        return _protocol_error(problem, headers)
    return Response(
        json.dumps(_members(problem)), problem.status, headers=headers, media_type=MEDIA_TYPE
    )


def _problem(error: Exception) -> Problem:
    """Return the problem of a refusal or of a failure."""
    match error:
        case ServiceError():
            return _refusal(error)
        case MemoryError():
            return _refusal(_out_of_memory())
        case _:
            return Problem(
                type="/problems/internal-error",
                title="The service failed",
                status=500,
                detail="The service failed; its log contains the reason.",
            )


def _out_of_memory() -> OutOfMemoryError:
    return OutOfMemoryError("There is not enough memory for this request.")


def _refusal(error: ServiceError) -> Problem:
    faults = [
        FieldError(
            field=_shorten(field_error.field),
            value=_presentable(field_error.value),
            expected=_shorten(field_error.expected, LONGEST_DETAIL),
        )
        for field_error in error.field_errors
    ]
    first = faults[0] if faults else FieldError()
    return Problem(
        type=f"/problems/{error.slug}",
        title=error.title,
        status=error.status,
        detail=_shorten(error.detail, LONGEST_DETAIL),
        **dict(first),
        errors=faults if len(faults) > 1 else None,
    )


def _http_problem(request: Request, error: HTTPException) -> Problem:
    phrase = HTTPStatus(error.status_code).phrase
    return Problem(
        type=f"/problems/{phrase.lower().replace(' ', '-')}",
        title=phrase,
        status=error.status_code,
        detail=f"{request.method} {_shorten(request.scope['path'])}: {error.detail}",
    )


def _protocol_error(problem: Problem, headers: Mapping[str, str]) -> Response:
    """Write a problem as the protocol does; it has no status for a value that is wrong."""
    status = HTTPStatus.BAD_REQUEST if problem.status == 422 else problem.status
    faults = problem.errors or ([] if problem.field is None else [problem])
    detail = "; ".join(
        f"{fault.field} is {_in_words(fault.value)}, expected {fault.expected}"
        for fault in faults[:MOST_FAULTS]
    )
    error = InferError(error=detail or problem.detail)
    return Response(
        json.dumps(error.model_dump()), status, headers=headers, media_type="application/json"
    )


def _in_words(value: JsonValue) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _members(problem: Problem) -> dict[str, JsonValue]:
    """Leave out the members that do not apply; a value may well be null."""
    members = problem.model_dump(exclude={"errors"} if problem.errors is None else None)
    if problem.field is None:
        del members["field"], members["value"], members["expected"]
    return members


def _presentable(value: object) -> JsonValue:
    """Shorten a value and make it safe for JSON: no surrogates, no infinities, no megabytes."""
    match value:
        case None | bool():
            return value
        case int() if abs(value) < 2**53:
            return value
        case float() if math.isfinite(value):
            return value
        case bytes():
            return f"{len(value)} bytes"
        case list() | tuple():
            items = cast("Sequence[object]", value)
            short = len(items) <= 4 and all(isinstance(item, int | float) for item in items)
            return [_presentable(item) for item in items] if short else f"{len(items)} items"
        case dict():
            return f"an object of {len(cast('dict[str, object]', value))} fields"
        case _:
            return _shorten(str(value))


def _shorten(text: str, longest: int = LONGEST_VALUE) -> str:
    shown = text[:longest].encode("utf-8", "backslashreplace").decode("utf-8")
    rest = len(text) - longest
    return f"{shown}... ({rest} more characters)" if rest > 0 else shown
