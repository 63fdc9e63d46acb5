"""Work off the event loop behind a bounded queue."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, Protocol, TypeVar

from service.errors import QueueFullError
from service.inference.deadlines import CancellationToken

P = ParamSpec("P")
T = TypeVar("T")


class Gauge(Protocol):
    """Follows a number, as Prometheus' own does."""

    def inc(self) -> None:
        """Count one more."""
        ...

    def dec(self) -> None:
        """Count one less."""
        ...


class AdmissionLimit:
    """A bounded number of places for requests that run or wait.

    Parameters
    ----------
    capacity
        Number of places.
    shown
        Follows the number that is taken.
    """

    def __init__(self, capacity: int, shown: Gauge) -> None:
        self._capacity = capacity
        self._shown = shown
        self._taken = 0
        self._lock = threading.Lock()

    @property
    def idle(self) -> bool:
        """True if no place is taken."""
        return self._taken == 0

    def acquire(self) -> None:
        """Take a place.

        Raises
        ------
        QueueFullError
            When all are taken.
        """
        with self._lock:
            if self._taken == self._capacity:
                raise QueueFullError(
                    f"{self._capacity} requests are being worked on or wait already"
                )
            self._taken += 1
            self._shown.inc()

    def release(self) -> None:
        """Give a place back."""
        with self._lock:
            self._taken -= 1
            self._shown.dec()


class AbandonableExecutor(Protocol):
    """An executor whose calls may end early, when their results are no longer needed."""

    def submit(
        self, abandoned: Future[None], call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs
    ) -> Future[T]:
        """Hand a call over; ``abandoned`` is done when its result is no longer wanted."""
        ...

    def close(self) -> None:
        """End the executor and its running calls."""
        ...


class Workers:
    """An executor that holds a bounded number of calls, running and waiting ones together.

    Parameters
    ----------
    executor
        Runs the calls; this object shuts it down.
    capacity
        Calls that it may hold.
    shown
        Follows the number that it holds.
    """

    def __init__(self, executor: AbandonableExecutor, capacity: int, shown: Gauge) -> None:
        self._executor = executor
        self._admission = AdmissionLimit(capacity, shown)

    @property
    def idle(self) -> bool:
        """True if no call runs or waits."""
        return self._admission.idle

    def submit(
        self, token: CancellationToken, call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs
    ) -> Future[T]:
        """Take a call. Cancelled before its turn, it never runs.

        Raises
        ------
        QueueFullError
            When ``capacity`` calls are being held.
        """
        self._admission.acquire()
        try:
            future = self._executor.submit(token.cancelled, call, *args, **kwargs)
        except BaseException:
            self._admission.release()
            raise
        future.add_done_callback(self._release)
        return future

    def _release(self, _: Future[T]) -> None:
        self._admission.release()

    def close(self) -> None:
        """End the executor and drop waiting calls."""
        self._executor.close()
