"""Which failed calls are sent again, and when. Calls change nothing, so repeating them is safe."""

from collections.abc import Callable

from tenacity import RetryCallState, wait_random_exponential

from rollcast.client.deadline import Deadline
from rollcast.errors import (
    ClientError,
    OverloadedError,
    RequestTimeoutError,
    ServerError,
    UnexpectedAnswerError,
    UnreachableError,
)

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
"""Bounds of the random wait before a call is sent again, which doubles every time."""
LONGEST_RETRY_AFTER_S = 60.0
"""Longest Retry-After that is waited for; after a longer one the error is raised at once."""
NOT_READY = 503
PROXY_STATUSES = {429, 500, 502, 503, 504}
"""Statuses of a proxy that cannot pass on a request or its answer."""

_backoff = wait_random_exponential(multiplier=FIRST_WAIT_S, max=LONGEST_WAIT_S)


def is_retryable(error: BaseException) -> bool:
    """Return whether a failed call may succeed when it is sent again.

    A service that failed by itself would fail again, and after a timeout no time remains.
    """
    match error:
        case RequestTimeoutError():
            return False
        case UnreachableError() | OverloadedError():
            return True
        case ServerError():
            return error.status_code == NOT_READY
        case UnexpectedAnswerError():
            return error.status_code in PROXY_STATUSES
        case _:
            return False


def wait_s(state: RetryCallState) -> float:
    """Return the seconds until the next attempt: Retry-After and a random wait on top."""
    return _retry_after_s(state) + _backoff(state)


def stop(retries: int, deadline: Deadline) -> Callable[[RetryCallState], bool]:
    """Return the rule that ends the attempts: by their number, or when the wait is too long."""

    def stops(state: RetryCallState) -> bool:
        return (
            state.attempt_number > retries
            or _retry_after_s(state) > LONGEST_RETRY_AFTER_S
            or state.upcoming_sleep >= deadline.left_s()
        )

    return stops


def _retry_after_s(state: RetryCallState) -> float:
    error = state.outcome.exception() if state.outcome else None
    return error.retry_after_s if isinstance(error, ClientError) else 0.0
