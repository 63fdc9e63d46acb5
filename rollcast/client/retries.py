"""When a call is sent again: what has failed may pass, and nothing is changed by asking twice."""

import httpx2
from tenacity import RetryCallState, wait_random_exponential

from rollcast.errors import (
    BusyError,
    ClientError,
    ServiceFailedError,
    UnexpectedAnswerError,
    UnreachableError,
)

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
"""Bounds of the random wait before a call is sent again, which doubles every time."""
NOT_READY = 503
OF_A_PROXY = {429, 500, 502, 503, 504}
"""Statuses that a proxy before the service gives when it cannot pass on a request or its answer."""

_backoff = wait_random_exponential(multiplier=FIRST_WAIT_S, max=LONGEST_WAIT_S)


def may_pass(error: BaseException) -> bool:
    """Tell whether a call that failed may go well when it is sent again.

    A service that failed by itself or took too long would do so again.
    """
    match error:
        case UnreachableError():
            late = httpx2.ReadTimeout, httpx2.WriteTimeout, httpx2.UnsupportedProtocol
            return not isinstance(error.__cause__, late)
        case BusyError():
            return True
        case ServiceFailedError():
            return error.problem.status == NOT_READY
        case UnexpectedAnswerError():
            return error.status in OF_A_PROXY
        case _:
            return False


def wait_s(attempts: RetryCallState) -> float:
    """Return how long to wait, at least as long as the service asked for (Retry-After)."""
    error = attempts.outcome.exception() if attempts.outcome else None
    asked = error.retry_after_s if isinstance(error, ClientError) else 0.0
    return asked + _backoff(attempts)
