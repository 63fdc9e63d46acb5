"""A budget of bytes over all request bodies that a process holds at a time."""

from collections.abc import Callable, Generator
from contextlib import contextmanager

from service.errors import TooManyBodiesError


class HeldBody:
    """One request body, or the frames of a session: its share of the budget."""

    def __init__(self) -> None:
        self.size = 0
        self.give_up: Callable[[], None] | None = None
        """Callback that stops reading the body or drops the frames; None once a body is read."""
        self.evicted = False

    def evict(self) -> None:
        """Give the bytes up."""
        self.evicted = True
        assert self.give_up is not None
        self.give_up()


class BodyBudget:
    """Counts the bytes of all bodies from their arrival until their requests have been parsed.

    Over the limit, the largest evictable body is evicted: a body or message that is still arriving,
    or the frames of a session. Large uploads that never end therefore leave room for requests of
    the usual size.

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
        self.resize(body, body.size + size)

    def resize(self, body: HeldBody, size: int) -> None:
        """Count a body with another size; with 0 it is released.

        Raises
        ------
        TooManyBodiesError
            When there is no room for it; it is released then.
        """
        self._release(body)
        if not size:
            return
        self._held.add(body)
        body.size = size
        self.size += size
        while self.size > self._limit:
            evictable = [held for held in self._held if held.give_up is not None]
            largest = max(evictable, key=lambda held: held.size, default=body)
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
            body.size = 0
