"""Reading of responses, and their exceptions."""

from collections.abc import Generator
from contextlib import contextmanager
from http import HTTPStatus

import httpx2
from pydantic import ValidationError

from rollcast.client.settings import Proxy
from rollcast.errors import (
    AuthError,
    BadRequestError,
    ClientError,
    OverloadedError,
    ProblemError,
    RequestTimeoutError,
    ServerError,
    UnexpectedAnswerError,
    UnreachableError,
)
from rollcast.schemas import REQUEST_ID_HEADER, Problem

MIB = 2**20
MAX_ANSWER_BYTES = 16 * MIB
"""Largest answer, decompressed, that is read of any call but ``simulate``."""
MAX_SIMULATION_BYTES = 256 * MIB
"""Largest answer of ``simulate``, which may hold a thousand frames."""
LONGEST_REASON = 300
"""Characters of a message that are taken from an answer or an address."""


@contextmanager
def translated(request: httpx2.Request, proxy: Proxy | None) -> Generator[None]:
    """Turn every error of a call into a ``ClientError`` that carries the request's identifier.

    Raises
    ------
    RequestTimeoutError
        When the time is over.
    UnreachableError
        When the answer is missing or incomplete.
    UnexpectedAnswerError
        When the answer is not valid HTTP.
    """
    way = f" through the proxy {proxy}, which NO_PROXY avoids" if proxy else ""
    try:
        try:
            yield
        except ClientError:
            raise
        except (httpx2.TimeoutException, TimeoutError) as error:
            limit_s = request.extensions["timeout"]["read"]
            raise RequestTimeoutError(
                f"{shown(request.url)} did not answer within {limit_s:g} s{way}"
            ) from error
        except (httpx2.SSEError, httpx2.DecodingError, httpx2.InvalidURL, ValueError) as error:
            raise UnexpectedAnswerError(
                f"{shown(request.url)} sent an answer that cannot be read{way}: {_reason(error)}"
            ) from error
        except httpx2.RequestError as error:
            raise UnreachableError(
                f"{shown(request.url)} does not answer{way}: {_reason(error)}"
            ) from error
    except ClientError as error:
        error.request_id = error.request_id or request.headers.get(REQUEST_ID_HEADER)
        raise


def failure(response: httpx2.Response, content: bytes | bytearray) -> ClientError:
    """Return the exception for an answer that reports a failure."""
    client_error: ClientError
    try:
        problem = Problem.model_validate_json(content)
        if problem.status != response.status_code:
            raise ValueError(f"its problem document has the status {problem.status}")
        client_error = problem_error(problem)
    except ValueError as error:
        client_error = unexpected(response, _redirection(response) or error)
    client_error.request_id = response.headers.get(REQUEST_ID_HEADER)
    client_error.retry_after_s = _retry_after_s(response)
    return client_error


def unexpected(response: httpx2.Response, reason: Exception | str) -> UnexpectedAnswerError:
    """Return the exception for an answer that is not a valid one of this API."""
    error = UnexpectedAnswerError(
        f"{shown(response.url)} answered {response.status_code} with a body that is not this "
        f"API's: {_reason(reason)}",
        response.status_code,
    )
    if isinstance(reason, Exception):
        error.__cause__ = reason
    return error


def problem_error(problem: Problem) -> ProblemError:
    """Return the exception for a problem document."""
    if problem.status in {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN}:
        return AuthError(problem)
    if problem.status == HTTPStatus.TOO_MANY_REQUESTS:
        return OverloadedError(problem)
    return ServerError(problem) if problem.status >= 500 else BadRequestError(problem)


def check_size(response: httpx2.Response, received: int, limit: int) -> None:
    """Refuse an answer that is too large, as early as that is known.

    Raises
    ------
    UnexpectedAnswerError
        When more has been received, or is announced, than is allowed.
    """
    announced = response.headers.get("content-length", "")
    if received > limit or (announced.isdecimal() and float(announced) > limit):
        raise UnexpectedAnswerError(
            f"{shown(response.url)} answered with more than the {limit / MIB:g} MiB that are "
            "allowed for this call",
            response.status_code,
        )


def shown(url: httpx2.URL) -> str:
    """Return an address for a message, without user name and password."""
    return _short(str(url.copy_with(userinfo=b"")))


def _redirection(response: httpx2.Response) -> str:
    """Say where a redirection, which is not followed, leads."""
    place = response.headers.get("location")
    return f"it redirects to {place!r}; use the address itself" if place else ""


def _retry_after_s(response: httpx2.Response) -> float:
    """Read the header Retry-After; a date, which this service never sends, counts as nothing."""
    text = response.headers.get("retry-after", "")
    return float(text) if text.isascii() and text.isdecimal() else 0.0


def _reason(error: Exception | str) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        return _short(f"{place}: {first['msg']}" if place else first["msg"])
    if isinstance(error, Exception):
        return _short(str(error) or repr(error))
    return _short(error)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_REASON else f"{text[:LONGEST_REASON]}..."
