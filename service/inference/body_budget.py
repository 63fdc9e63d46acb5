"""A budget of bytes over all request bodies that a process holds at a time."""

import asyncio
from collections.abc import Generator
from contextlib import contextmanager

from service.errors import TooManyBodiesError


class HeldBody:
    """One request body: what it takes of the budget."""

    def __init__(self) -> None:
        self.size = 0
        self.timeout: asyncio.Timeout | None = None
        """Ends the reading of the body; None once it has been read."""
        self.evicted = False

    def evict(self) -> None:
        """Stop reading the body, in the task that reads it."""
        self.evicted = True
        assert self.timeout is not None
        self.timeout.reschedule(asyncio.get_running_loop().time())


class BodyBudget:
    """Counts the bytes of all bodies from their arrival until their requests have been parsed.

    Over the limit, the largest body that is still arriving is given up: many large uploads that
    never end cost their senders, and leave room for requests of the usual size.

    Parameters
    ----------
    limit
        Bytes that all bodies may have together.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._held: set[HeldBody] = set()
        self.size = 0
        """Bytes that are held."""

    @contextmanager
    def body(self) -> Generator[HeldBody]:
        """Hold one body until the block is left."""
        body = HeldBody()
        self._held.add(body)
        try:
            yield body
        finally:
            self._release(body)

    def grow(self, body: HeldBody, size: int) -> None:
        """Count bytes that have arrived.

        Raises
        ------
        TooManyBodiesError
            When there is no room for them, and no larger body is still arriving.
        """
        body.size += size
        self.size += size
        while self.size > self._limit:
            arriving = [held for held in self._held if held.timeout is not None]
            largest = max(arriving, key=lambda held: held.size)
            self._release(largest)
            if largest is body:
                raise self.exceeded()
            largest.evict()

    def exceeded(self) -> TooManyBodiesError:
        """Return the refusal of a body that there is no room for."""
        return TooManyBodiesError(f"All request bodies together exceed {self._limit} bytes.")

    def _release(self, body: HeldBody) -> None:
        if body in self._held:
            self._held.remove(body)
            self.size -= body.size
