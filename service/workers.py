"""Work off the event loop behind a bounded queue."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import ParamSpec, TypeVar

from service.errors import QueueFullError

P = ParamSpec("P")
T = TypeVar("T")


class Workers:
    """An executor that holds a bounded number of calls, running and waiting ones together.

    Parameters
    ----------
    executor
        Runs the calls; this object shuts it down.
    capacity
        Calls that it may hold.
    """

    def __init__(self, executor: Executor, capacity: int) -> None:
        self._executor = executor
        self._slots = threading.BoundedSemaphore(capacity)
        self._capacity = capacity

    async def run(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call and return what it returns. Cancelled before its turn, it never runs.

        Raises
        ------
        QueueFullError
            When ``capacity`` calls are being held.
        """
        if not self._slots.acquire(blocking=False):
            raise QueueFullError(f"{self._capacity} requests are being worked on or wait already")
        try:
            future = self._executor.submit(call, *args, **kwargs)
        except BaseException:
            self._slots.release()
            raise
        future.add_done_callback(self._release)
        return await asyncio.wrap_future(future)

    def _release(self, _: Future[T]) -> None:
        self._slots.release()

    def close(self) -> None:
        """Let running calls end, drop waiting ones."""
        self._executor.shutdown(cancel_futures=True)
