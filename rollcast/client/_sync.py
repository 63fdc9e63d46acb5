"""Parts of ``Client`` that differ from ``AsyncClient``.

``rollcast.client._async`` has the same names for ``AsyncClient``.
"""

import socket
import struct
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from queue import Empty, Queue
from ssl import SSLContext
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, ParamSpec, Self, TypeVar, cast

import httpx2
from tenacity import Retrying, retry_if_exception

from rollcast.client.connection import Target
from rollcast.client.deadline import Deadline
from rollcast.client.retries import is_retryable, stop, wait_s
from rollcast.client.sessions import handshake

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

P = ParamSpec("P")
T = TypeVar("T")

PIECE_BYTES = 2**16
"""Number of bytes that are written between checks of the deadline."""
SHORTEST_TIMEOUT_S = 1e-3
"""Shortest timeout of a socket, for which 0 would mean not to wait at all."""


class Connections:
    """The HTTP client of one target.

    Parameters
    ----------
    target
        The service.
    transport
        Sends the requests; by default over the network.

    Raises
    ------
    InvalidArgumentError
        When the environment names a proxy or certificates that cannot be used.
    """

    def __init__(self, target: Target, transport: httpx2.BaseTransport | None) -> None:
        self._target, self._transport = target, transport
        self._lock = Lock()
        self._client: httpx2.Client | None = (
            self._made()
        )  # so that errors of the environment are raised here

    def client(self) -> httpx2.Client:
        """Return the HTTP client."""
        with self._lock:
            if self._client is None:
                self._client = self._made()
            return self._client

    def close(self) -> None:
        """Close the connections; a later call opens new ones."""
        with self._lock:
            http, self._client = self._client, None
        if http is not None:
            http.close()

    def _made(self) -> httpx2.Client:
        transport = self._transport or self._target.transport(_NetworkTransport)
        return httpx2.Client(transport=transport, **self._target.options())


class _NetworkTransport(httpx2.HTTPTransport):
    """A transport that keeps to a ``Deadline`` which is given as the timeout of a request.

    The transports of httpx2 limit every read and write by itself, so a server that sends a byte now
    and then is never late for them. The awaited client is interrupted from outside instead.
    """

    def __init__(self, proxy: str | None) -> None:
        super().__init__(proxy=proxy)
        # httpx2 has no argument for the network backend of its connection pool.
        pool: Any = self._pool
        pool._network_backend = _Backend(pool._network_backend)


class _Backend:
    """A network backend of httpcore2 whose streams keep to deadlines."""

    def __init__(self, backend: object) -> None:
        self._backend: Any = backend

    def connect_tcp(
        self, host: str, port: int, timeout: float | None = None, **options: object
    ) -> "_Stream":
        if not isinstance(timeout, Deadline):
            return _Stream(self._backend.connect_tcp(host, port, timeout=timeout, **options))
        addresses = _resolved(host, port, timeout)
        for others in range(len(addresses) - 1, 0, -1):
            address = addresses.pop(0)
            share_s = (_left_s(timeout) or 0.0) / (others + 1)  # the rest is for the others
            with suppress(Exception):  # the last address's is reported
                return _Stream(self._backend.connect_tcp(address, port, timeout=share_s, **options))
        (address,) = addresses
        stream = self._backend.connect_tcp(address, port, timeout=_left_s(timeout), **options)
        return _Stream(stream)

    def sleep(self, seconds: float) -> None:
        self._backend.sleep(seconds)


class _Stream:
    """A network stream of httpcore2 that keeps to deadlines."""

    def __init__(self, stream: object) -> None:
        self._stream: Any = stream

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, timeout=_left_s(timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        for start in range(0, len(buffer), PIECE_BYTES):
            piece = buffer[start : start + PIECE_BYTES]
            self._stream.write(piece, timeout=_left_s(timeout))

    def start_tls(
        self,
        ssl_context: SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> "_Stream":
        return _Stream(self._stream.start_tls(ssl_context, server_hostname, _left_s(timeout)))

    def get_extra_info(self, info: str) -> object:
        return self._stream.get_extra_info(info)

    def close(self) -> None:
        self._stream.close()


def _resolved(host: str, port: int, deadline: Deadline) -> list[str]:
    """Return the addresses of a host; the host itself when it has none, which fails to connect.

    Raises
    ------
    TimeoutError
        When the resolver takes longer than the deadline; its thread ends by itself.
    """
    answers: Queue[list[str]] = Queue()

    def resolve() -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError):
            found = []
        answers.put(list(dict.fromkeys(str(sockaddr[0]) for *_, sockaddr in found)) or [host])

    Thread(target=resolve, daemon=True).start()
    try:
        return answers.get(timeout=_left_s(deadline))
    except Empty as error:
        raise TimeoutError(f"{host} is not resolved within {float(deadline):g} s") from error


def _left_s(timeout: float | None) -> float | None:
    """Return the rest of a deadline; another timeout is returned as it is."""
    if not isinstance(timeout, Deadline):
        return timeout
    timeout.check()
    return max(timeout.left_s(), SHORTEST_TIMEOUT_S)


@contextmanager
def within(deadline: Deadline) -> Generator[None]:
    """Run a deadline, which every wait checks."""
    deadline.resume()
    try:
        yield
    finally:
        deadline.pause()


def to_thread(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call a function; the caller waits for it anyway."""
    return function(*args, **kwargs)


def with_retries(call: Callable[[], T], retries: int, deadline: Deadline) -> T:
    """Make a call, and repeat it while its failure is retryable."""
    for attempt in Retrying(
        retry=retry_if_exception(is_retryable),
        wait=wait_s,
        stop=stop(retries, deadline),
        reraise=True,
    ):
        with attempt:
            return call()
    raise AssertionError("an attempt returns or raises")


def gather_limited(calls: Sequence[Callable[[], T]], concurrency: int) -> list[T]:
    """Make many calls, ``concurrency`` at once, and return their results in order.

    After the first failure no further call begins, and it is raised.
    """
    with ThreadPoolExecutor(concurrency) as threads:
        futures = [threads.submit(call) for call in calls]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
        finally:
            for future in futures:
                future.cancel()
        return [future.result() for future in futures]


class Socket:
    """A WebSocket connection; exceptions are those of ``websockets``.

    Parameters
    ----------
    connection
        The open connection.
    opened
        Closes it.
    """

    def __init__(self, connection: "ClientConnection", opened: ExitStack) -> None:
        self._connection, self._opened = connection, opened

    @classmethod
    def open(cls, address: str, options: dict[str, Any], deadline: Deadline) -> Self:
        """Connect within a deadline, which runs."""
        # Imported here because most programs open no session.
        from websockets.sync.client import connect

        opened = ExitStack()
        open_timeout = max(deadline.left_s(), SHORTEST_TIMEOUT_S)
        with handshake():
            connecting = cast(
                "ClientConnection", connect(address, open_timeout=open_timeout, **options)
            )
        connection = opened.enter_context(connecting)
        # Sending has no timeout there; a service that reads nothing would block it for minutes.
        limit = struct.pack("ll", int(deadline), int(deadline % 1 * 1e6) or 1)
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        return cls(connection, opened)

    def send(self, message: str | bytes) -> None:
        """Send a message."""
        self._connection.send(message)

    def receive(self, deadline: Deadline) -> str | bytes:
        """Return the next message; TimeoutError after the deadline."""
        return self._connection.recv(deadline.left_s())

    def received(self) -> str | bytes | None:
        """Return the next message if it has arrived."""
        try:
            return self._connection.recv(0)
        except TimeoutError:
            return None

    def close(self) -> None:
        """Close the connection."""
        self._opened.close()
