"""From the bytes of a request to its validated body; nothing is read beyond the limit."""

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, NoReturn, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from service.errors import (
    BodyTooLargeError,
    BodyTooSlowError,
    InvalidValueError,
    MalformedBodyError,
    ServiceError,
    UnsupportedMediaTypeError,
)
from service.http.problem_details import invalid_values

JSON = "application/json"
MULTIPART = "multipart/form-data"
MAX_DIGITS = 18
"""Of an announced length; more are no length of anything."""
MAX_PARTS = 32
MAX_TEXT_PART_BYTES = 4096

B = TypeVar("B", bound=BaseModel)


def media_type(request: Request, accepted: Sequence[str]) -> str:
    """Return the request's content type without its parameters.

    Raises
    ------
    UnsupportedMediaTypeError
        When it is not one of those accepted.
    """
    given = request.headers.get("content-type", "")
    kind = given.partition(";")[0].strip().lower()
    if kind not in accepted:
        raise UnsupportedMediaTypeError.at("content-type", given, " or ".join(accepted))
    return kind


async def read_body(request: Request) -> bytes:
    """Read the whole body.

    Raises
    ------
    BodyTooLargeError
        As soon as the limit of the settings is passed, or at once when the header announces it.
    BodyTooSlowError
        When it has not ended in the time of the settings.
    """
    async with _in_time(request):
        return b"".join([chunk async for chunk in _limited(request)])


@asynccontextmanager
async def _in_time(request: Request) -> AsyncGenerator[None]:
    seconds = request.app.state.service.settings.receive_timeout_s
    try:
        async with asyncio.timeout(seconds):
            yield
    except TimeoutError as error:
        raise BodyTooSlowError(f"The body had not ended after {seconds:g} s.") from error


async def _limited(request: Request) -> AsyncIterator[bytes]:
    limit = request.app.state.service.settings.max_body_bytes
    announced = request.headers.get("content-length", "0")
    if announced.isdecimal() and int(announced[:MAX_DIGITS]) > limit:
        raise _too_large(limit, announced)
    size = 0
    try:
        async for chunk in request.stream():
            size += len(chunk)
            if size > limit:
                raise _too_large(limit, f"more than {limit}")
            yield chunk
    except ClientDisconnect as error:
        raise MalformedBodyError("The client went away before the body ended.") from error


def _too_large(limit: int, size: object) -> ServiceError:
    return BodyTooLargeError.at("body", size, f"at most {limit} bytes")


def parse_json(body: bytes, model: type[B]) -> B:
    """Parse and validate a JSON body.

    Raises
    ------
    MalformedBodyError
        When it is not JSON as RFC 8259 has it: NaN, a name given twice, a lone surrogate.
    InvalidValueError
        When a value is wrong; every wrong value is named.
    """
    try:
        data = json.loads(
            body.decode("utf-8"), object_pairs_hook=_object, parse_constant=_refuse_constant
        )
    except UnicodeDecodeError as error:
        raise MalformedBodyError(f"The body is not UTF-8 at byte {error.start}.") from error
    except RecursionError as error:
        raise MalformedBodyError("The body is nested too deeply.") from error
    except ValueError as error:
        raise MalformedBodyError(f"The body is not JSON: {error}.") from error
    return _validate(model, data, strict=None)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise MalformedBodyError.at("body", twice, "every name once in an object")
    for text in (text for pair in pairs for text in pair if isinstance(text, str)):
        if not text.isascii():
            _refuse_surrogates(text)
    return members


def _refuse_surrogates(text: str) -> None:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise MalformedBodyError.at("body", text, "Unicode text, no lone surrogates") from error


def _refuse_constant(name: str) -> NoReturn:
    raise MalformedBodyError.at("body", name, "a number: JSON has no such value")


async def read_form(request: Request, model: type[B], lists: frozenset[str]) -> B:
    """Read and validate a multipart body; text parts become numbers where a number is due.

    Parameters
    ----------
    request
        The request.
    model
        Its body.
    lists
        Names of the parts that may come several times.

    Raises
    ------
    BodyTooLargeError, BodyTooSlowError, MalformedBodyError, InvalidValueError
        As for JSON.
    """
    parser = MultiPartParser(
        request.headers,
        _limited(request),  # pyright: ignore[reportArgumentType] - it only iterates
        max_files=MAX_PARTS,
        max_fields=MAX_PARTS,
        max_part_size=MAX_TEXT_PART_BYTES,
    )
    # No body goes through a disk, which may be full: this much memory it may take anyway.
    parser.spool_max_size = request.app.state.service.settings.max_body_bytes
    try:
        async with _in_time(request):
            form = await parser.parse()
        data = await _parts(form, lists)
    except MultiPartException as error:
        raise MalformedBodyError(f"The body is not multipart: {error.message}") from error
    finally:
        # Those of parts that never ended are in no form, and nobody else closes them.
        for file in parser._files_to_close_on_error:  # pyright: ignore[reportPrivateUsage]
            file.close()
    return _validate(model, data, strict=False)


async def _parts(form: FormData, lists: frozenset[str]) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for name, part in form.multi_items():
        value = await part.read() if isinstance(part, UploadFile) else part
        if name in lists:
            data.setdefault(name, []).append(value)
        elif name in data:
            raise InvalidValueError.at(name, value, "one part of this name")
        else:
            data[name] = value
    return data


def _validate(model: type[B], data: object, *, strict: bool | None) -> B:
    try:
        return model.model_validate(data, strict=strict)
    except ValidationError as error:
        refusal = invalid_values(error.errors(include_url=False))
    # Not from the error: it is no Python object, and holds the frames that led to it, and with them
    # the body and this request, where the garbage collector does not see that nobody else does.
    raise refusal
