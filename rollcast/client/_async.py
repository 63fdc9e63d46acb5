"""Parts of ``AsyncClient`` that differ from ``Client``.

``rollcast.client._sync`` has the same names for ``Client``.
"""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import TYPE_CHECKING, Any, ParamSpec, Self, TypeVar

import httpx2
from tenacity import AsyncRetrying, retry_if_exception

from rollcast.client.connection import Target
from rollcast.client.deadline import Deadline
from rollcast.client.retries import is_retryable, stop, wait_s
from rollcast.client.sessions import handshake

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection

P = ParamSpec("P")
T = TypeVar("T")


class Connections:
    """HTTP clients of one target: one for each event loop, because connections belong to a loop.

    Parameters
    ----------
    target
        The service.
    transport
        Sends the requests of every loop; by default each loop has its own, over the network.

    Raises
    ------
    InvalidArgumentError
        When the environment names a proxy or certificates that cannot be used.
    """

    def __init__(self, target: Target, transport: httpx2.AsyncBaseTransport | None) -> None:
        self._target, self._transport = target, transport
        self._clients: dict[asyncio.AbstractEventLoop, httpx2.AsyncClient] = {}
        self._spare: httpx2.AsyncClient | None = (
            self._made()
        )  # so that errors of the environment are raised here

    def client(self) -> httpx2.AsyncClient:
        """Return the HTTP client of the running event loop."""
        loop = asyncio.get_running_loop()
        if loop not in self._clients:
            self._forget_closed_loops()
            self._clients[loop] = self._spare or self._made()
            self._spare = None
        return self._clients[loop]

    async def close(self) -> None:
        """Close the connections of the running event loop; a later call opens new ones."""
        self._forget_closed_loops()
        http = self._clients.pop(asyncio.get_running_loop(), None)
        if http is not None:
            await http.aclose()

    def _made(self) -> httpx2.AsyncClient:
        transport = self._transport or self._target.transport(httpx2.AsyncHTTPTransport)
        return httpx2.AsyncClient(transport=transport, **self._target.options())

    def _forget_closed_loops(self) -> None:
        for loop in [loop for loop in self._clients if loop.is_closed()]:
            del self._clients[loop]


@asynccontextmanager
async def within(deadline: Deadline) -> AsyncGenerator[None]:
    """Let a deadline run, and raise TimeoutError when it is over."""
    deadline.resume()
    try:
        async with asyncio.timeout(deadline.left_s()):
            yield
    finally:
        deadline.pause()


async def to_thread(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call a function that computes for a while, such as encoding images, in a thread."""
    return await asyncio.to_thread(function, *args, **kwargs)


async def with_retries(call: Callable[[], Awaitable[T]], retries: int, deadline: Deadline) -> T:
    """Make a call, and repeat it while its failure is retryable."""
    async for attempt in AsyncRetrying(
        retry=retry_if_exception(is_retryable),
        wait=wait_s,
        stop=stop(retries, deadline),
        reraise=True,
    ):
        with attempt:
            return await call()
    raise AssertionError("an attempt returns or raises")


async def gather_limited(calls: Sequence[Callable[[], Awaitable[T]]], concurrency: int) -> list[T]:
    """Make many calls, ``concurrency`` at once, and return their results in order.

    The first failure cancels the other calls and is raised.
    """
    limit = asyncio.Semaphore(concurrency)

    async def limited(call: Callable[[], Awaitable[T]]) -> T:
        async with limit:
            return await call()

    tasks = [asyncio.ensure_future(limited(call)) for call in calls]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class Socket:
    """A WebSocket connection; exceptions are those of ``websockets``.

    Parameters
    ----------
    connection
        The open connection.
    opened
        Closes it.
    """

    def __init__(self, connection: "ClientConnection", opened: AsyncExitStack) -> None:
        self._connection, self._opened = connection, opened

    @classmethod
    async def open(cls, address: str, options: dict[str, Any], deadline: Deadline) -> Self:
        """Connect within a deadline, which runs."""
        # Imported here because most programs open no session.
        from websockets.asyncio.client import connect

        opened = AsyncExitStack()
        open_timeout = max(deadline.left_s(), 1e-3)
        connecting = connect(address, open_timeout=open_timeout, **options)
        with handshake():
            return cls(await opened.enter_async_context(connecting), opened)

    async def send(self, message: str | bytes) -> None:
        """Send a message."""
        await self._connection.send(message)

    async def receive(self, deadline: Deadline) -> str | bytes:  # noqa: ARG002 - as in _sync
        """Return the next message; the deadline interrupts the wait."""
        return await self._connection.recv()

    async def received(self) -> str | bytes | None:
        """Return the next message if it has arrived."""
        try:
            async with asyncio.timeout(0):
                return await self._connection.recv()
        except TimeoutError:
            return None

    async def close(self) -> None:
        """Close the connection."""
        await self._opened.aclose()
