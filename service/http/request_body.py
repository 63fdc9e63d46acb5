"""Parsing and validation of request bodies.

Reading is bounded by the bytes of one body, by its time, and by the bytes of all bodies. Parsing is
bounded by counts that are taken from the bytes before, so that a refusal costs time and memory in
proportion to its body; it belongs into a thread.
"""

import asyncio
import gc
from codecs import BOM_UTF8 as UTF8_BOM
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any, TypeAlias, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect

from rollcast.schemas import RequestBody, accepted_names
from service.errors import (
    BodyTooLargeError,
    BodyTooSlowError,
    InvalidValueError,
    MalformedBodyError,
    ServiceError,
    UnsupportedMediaTypeError,
)
from service.http.problem_details import invalid_values
from service.inference.body_budget import HeldBody

JSON = "application/json"
MULTIPART = "multipart/form-data"
MAX_DIGITS = 18
"""Digits of an announced length; more are no length of anything."""
MAX_NAMES = 1000
"""Names that a JSON body may have, in all its objects."""
MAX_VALUES = 1000
"""Values and lists that a JSON body without tensors may have."""
MAX_PARTS = 32
MAX_TEXT_PART_BYTES = 4096
FILES = frozenset({"frames", "final_frame"})
LISTS = frozenset({"frames"})
"""Parts of a form that are files, and parts that may be repeated."""
PIECE_BYTES = 64 * 1024
"""Bytes of a form that are parsed before its parser may be interrupted."""

B = TypeVar("B", bound=BaseModel)
R = TypeVar("R", bound=RequestBody)
Parser: TypeAlias = Callable[[Callable[[], None]], tuple[R, list[str]]]
"""Function from a check for cancellation, which it calls regularly, to the parsed request and the
names of its files, where given."""
Body = bytes | bytearray


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


@asynccontextmanager
async def received(request: Request, limit: int | None = None) -> AsyncGenerator[Body]:
    """Read the whole body, and hold its bytes in the service's budget until the block is left.

    Parameters
    ----------
    request
        The request.
    limit
        Largest body of the route in bytes, where it is less than the setting's.

    Raises
    ------
    UnsupportedMediaTypeError
        When the body is compressed.
    BodyTooLargeError
        As soon as the limit is passed, or at once when the header announces it.
    BodyTooSlowError
        When it has not ended in the time of the settings.
    TooManyBodiesError
        When there is no room for it beside the bodies of other requests.
    """
    service = request.app.state.service
    _check_encoding(request)
    most: int = service.settings.max_body_bytes
    most = most if limit is None else min(limit, most)
    with service.bodies.body() as held:
        seconds = service.settings.read_timeout_s
        try:
            async with asyncio.timeout(seconds) as timeout:
                loop = asyncio.get_running_loop()
                held.give_up = lambda: timeout.reschedule(loop.time())
                body = await _read(request, most, held)
        except TimeoutError as error:
            if held.evicted:
                raise service.bodies.exceeded() from error
            raise BodyTooSlowError(f"The body was not complete after {seconds:g} s.") from error
        finally:
            held.give_up = None
        if held.evicted:
            raise service.bodies.exceeded()
        yield body


def _check_encoding(request: Request) -> None:
    for name, plain in (("content-encoding", "identity"), ("transfer-encoding", "chunked")):
        encoding = ", ".join(request.headers.getlist(name))
        if encoding.strip().lower() not in ("", plain):
            expected = "none: compressed bodies are not supported"
            raise UnsupportedMediaTypeError.at(name, encoding, expected)


async def _read(request: Request, limit: int, held: HeldBody) -> bytearray:
    announced = request.headers.get("content-length", "0")
    if announced.isdecimal() and int(announced[:MAX_DIGITS]) > limit:
        raise _too_large(limit, announced)
    body = bytearray()
    try:
        async for chunk in request.stream():
            if len(body) + len(chunk) > limit:
                raise _too_large(limit, f"more than {limit}")
            request.app.state.service.bodies.grow(held, len(chunk))
            body += chunk
    except ClientDisconnect as error:
        raise MalformedBodyError("The client disconnected before the end of the body.") from error
    return body


def _too_large(limit: int, size: object) -> ServiceError:
    return BodyTooLargeError.at("body", size, f"at most {limit} bytes")


def parse_json(body: Body, model: type[B], max_values: int = MAX_VALUES) -> B:
    """Parse and validate a JSON body.

    If a name is given twice, the last value is used.

    Parameters
    ----------
    body
        UTF-8 text, with or without a byte order mark.
    model
        Model of the body.
    max_values
        Largest number of values and lists.

    Raises
    ------
    MalformedBodyError
        When it is not JSON as RFC 8259 has it (NaN, a lone surrogate), or has more names or values
        than the limits allow.
    InvalidValueError
        When a value is wrong; the wrong values are named.
    """
    names = body.count(b":")
    values = body.count(b",") + body.count(b"[") + body.count(b"{")
    if names > MAX_NAMES or values > max_values:
        raise MalformedBodyError(
            f"The body has {names} names and {values} values and lists; "
            f"at most {MAX_NAMES} and {max_values} are allowed. Encode images as base64 text."
        )
    # While lists are made that nothing can have dropped yet, collecting takes six times as long as
    # parsing; the interpreter's lock is held for all of it.
    gc.disable()
    try:
        data = from_json(body.removeprefix(UTF8_BOM), allow_inf_nan=False)
    except ValueError as error:
        raise MalformedBodyError(f"The body is not JSON: {error}.") from error
    finally:
        gc.enable()
    return _validate(model, data, strict=None)


def parser_of(model: type[R], kind: str, body: Body, request: Request) -> Parser[R]:
    """Return the parser of a body with frames, which runs in a worker thread."""
    if kind == JSON:
        return lambda _: (parse_json(body, model), [])
    content_type = request.headers["content-type"]
    return lambda check: parse_form(
        body, content_type, model, files=FILES, lists=LISTS, check=check
    )


def parse_form(
    body: Body,
    content_type: str,
    model: type[R],
    *,
    files: frozenset[str],
    lists: frozenset[str],
    check: Callable[[], None],
) -> tuple[R, list[str]]:
    """Parse and validate a multipart body; text parts become numbers where a number is due.

    Parameters
    ----------
    body
        The whole body.
    content_type
        The header, with the boundary.
    model
        Model of the body.
    files
        Names of the parts that are files; they need no file name.
    lists
        Names of the parts that may be repeated.
    check
        Called regularly; its exception ends the parsing.

    Returns
    -------
    tuple
        The request, and the file names of the parts that may come several times.

    Raises
    ------
    MalformedBodyError, InvalidValueError
        As for JSON.
    """
    _, options = parse_options_header(content_type)
    boundary = options.get(b"boundary")
    if not boundary:
        raise MalformedBodyError("The content type of a multipart body needs a boundary.")
    form = _Form(accepted_names(model), files, lists)
    try:
        parser = MultipartParser(
            boundary,
            {
                "on_part_begin": form.on_part_begin,
                "on_header_begin": form.on_header_begin,
                "on_header_field": form.on_header_field,
                "on_header_value": form.on_header_value,
                "on_header_end": form.on_header_end,
                "on_headers_finished": form.on_headers_finished,
                "on_part_data": form.on_part_data,
                "on_part_end": form.on_part_end,
                "on_end": form.on_end,
            },
        )
        for start in range(0, len(body), PIECE_BYTES):
            check()
            parser.write(bytes(memoryview(body)[start : start + PIECE_BYTES]))
        parser.finalize()
    except FormParserError as error:
        raise MalformedBodyError(f"The body is not multipart: {error}.") from error
    if not form.ended:
        raise MalformedBodyError("The body is not multipart: its last boundary is missing.")
    return _validate(model, form.data, strict=False), form.file_names


class _Form:
    """Collector of the parts of a form, called by its parser.

    Attributes
    ----------
    data
        Values by name: bytes of files, texts, lists of them.
    ended
        Whether the last boundary has been read.
    file_names
        Names of the files in the parts that may come several times.
    """

    def __init__(self, known: frozenset[str], files: frozenset[str], lists: frozenset[str]) -> None:
        self.data: dict[str, Any] = {}
        self.ended = False
        self.file_names: list[str] = []
        self._known = known
        self._files = files
        self._lists = lists
        self._parts = 0
        self._header = self._value = b""
        self._disposition = ""
        self._name = ""
        self._content = bytearray()

    def on_part_begin(self) -> None:
        """Begin a part."""
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise MalformedBodyError(
                f"The form has too many parts, at most {MAX_PARTS} are allowed."
            )
        self._disposition = ""
        self._content = bytearray()

    def on_header_begin(self) -> None:
        """Begin a header."""
        self._header = self._value = b""

    def on_header_field(self, data: bytes, start: int, end: int) -> None:
        """Take a piece of a header's name."""
        self._header += data[start:end]

    def on_header_value(self, data: bytes, start: int, end: int) -> None:
        """Take a piece of a header's value."""
        self._value += data[start:end]

    def on_header_end(self) -> None:
        """Keep the one header that matters."""
        if self._header.lower() == b"content-disposition":
            self._disposition = self._value.decode("latin-1")

    def on_headers_finished(self) -> None:
        """Check the part's name."""
        _, options = parse_options_header(self._disposition)
        if b"name" not in options:
            raise MalformedBodyError("A part has no name: Content-Disposition: form-data; name=...")
        self._name = name = options[b"name"].decode("utf-8", "backslashreplace")
        if name not in self._known:
            raise InvalidValueError.at(name, "a part", self._instead_of(name))
        if name in self.data and name not in self._lists:
            raise InvalidValueError.at(name, "several parts", "one part of this name")
        if name in self._lists and b"filename" in options:
            self.file_names.append(options[b"filename"].decode("utf-8", "backslashreplace"))

    def _instead_of(self, name: str) -> str:
        base, bracket, _ = name.partition("[")
        if not bracket or base not in self._known:
            return "no such field"
        return f"the name {base!r}" + (", once for each file" if base in self._lists else "")

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        """Take a piece of the part's content."""
        self._content += data[start:end]
        if self._name not in self._files and len(self._content) > MAX_TEXT_PART_BYTES:
            raise MalformedBodyError.at(
                self._name, f"more than {MAX_TEXT_PART_BYTES} bytes", "a short text"
            )

    def on_part_end(self) -> None:
        """Keep the part."""
        value: bytes | str = bytes(self._content)
        if self._name not in self._files:
            try:
                value = value.decode("utf-8")
            except UnicodeDecodeError as error:
                raise MalformedBodyError.at(self._name, value, "UTF-8 text") from error
        if self._name in self._lists:
            self.data.setdefault(self._name, []).append(value)
        else:
            self.data[self._name] = value

    def on_end(self) -> None:
        """Note that the form is whole."""
        self.ended = True


def _validate(model: type[B], data: object, *, strict: bool | None) -> B:
    try:
        return model.model_validate(data, strict=strict)
    except ValidationError as error:
        refusal = invalid_values(error.errors(include_url=False))
    # Not from the error, which is no Python object: it references the stack frames that led to it,
    # and thereby body and request, in a cycle that the garbage collector cannot find.
    raise refusal
