"""What the client that blocks does otherwise than the awaited one (``rollcast.client._async``)."""

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import ParamSpec, TypeVar

from tenacity import Retrying, retry_if_exception, stop_after_attempt

from rollcast.client.retries import may_pass, wait_s

P = ParamSpec("P")
T = TypeVar("T")


def off_the_loop(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Do it here: whoever calls waits anyway."""
    return function(*args, **kwargs)


def repeated(call: Callable[[], T], retries: int) -> T:
    """Make a call, and again while what failed may pass."""
    for attempt in Retrying(
        retry=retry_if_exception(may_pass),
        wait=wait_s,
        stop=stop_after_attempt(1 + retries),
        reraise=True,
    ):
        with attempt:
            return call()
    raise AssertionError("an attempt returns or raises")


def side_by_side(calls: Sequence[Callable[[], T]], at_once: int) -> list[T]:
    """Make many calls, some at once, and return their results in order.

    The first that fails keeps those that wait from beginning, and its exception is raised.
    """
    with ThreadPoolExecutor(at_once) as threads:
        futures = [threads.submit(call) for call in calls]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
        finally:
            for future in futures:
                future.cancel()
        return [future.result() for future in futures]
