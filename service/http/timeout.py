"""Time limit of a request over HTTP, and the status of requests whose client has disconnected."""

from starlette.requests import HTTPConnection

from service.errors import InvalidValueError
from service.settings import Settings

TIMEOUT_HEADER = "x-request-timeout-ms"
CLIENT_CLOSED_REQUEST = 499
"""Status in the access log of requests whose client disconnected before the answer."""


def timeout_s(request: HTTPConnection, settings: Settings) -> float:
    """Time limit of a request in seconds: the limit in its header, at most that of the settings.

    Raises
    ------
    InvalidValueError
        When the header is not a whole number of milliseconds.
    """
    text = request.headers.get(TIMEOUT_HEADER)
    if text is None:
        return settings.deadline_s
    if not (text.isascii() and text.isdigit() and 1 <= len(text) <= 9 and int(text) > 0):
        expected = "a whole number of milliseconds, 1 to 999999999"
        raise InvalidValueError.at(TIMEOUT_HEADER, text, expected)
    return min(int(text) / 1000, settings.deadline_s)
