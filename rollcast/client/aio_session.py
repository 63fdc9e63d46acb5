"""The session of a client: a frame a tick, and an answer for every tick."""

from functools import partial
from types import TracebackType
from typing import Self

from rollcast.client._async import Socket, to_thread, with_retries, within
from rollcast.client.calls import Call
from rollcast.client.connection import Target, checked_timeout
from rollcast.client.deadline import Deadline
from rollcast.client.images import Crop, Frame, encoded
from rollcast.client.results import Forecast
from rollcast.client.sessions import (
    LocalSession,
    SessionCall,
    SessionTransport,
    TickAnswer,
    newest_of,
)
from rollcast.frames import Channels


class AsyncSession:
    """A session with the service, which keeps the last four frames. Use it as a context manager.

    The newest frame wins: while a forecast is computed, further frames are kept without a forecast
    of their own. Every frame gets exactly one answer, in the order of frames. Frames have to be
    evenly spaced in time and of one size. Answers have to be read: the service closes a session
    whose client reads nothing for a minute.

    After an ``UnreachableError`` the session is over; open another one.
    """

    def __init__(
        self,
        target: Target,
        call: Call[Forecast],
        crop: Crop | None,
        channels: Channels,
        *,
        timeout_s: float,
        retries: int,
        transport: SessionTransport | None,
    ) -> None:
        self._call = SessionCall(target, call)
        self._transport = transport
        self._crop: Crop | None = crop
        self._channels: Channels = channels
        self._timeout_s = timeout_s
        self._retries = retries
        self._socket: Socket | _LocalSocket | None = None
        self._sent = 0

    async def send(self, frame: Frame) -> int:
        """Send the next frame and return its number, from 1.

        Parameters
        ----------
        frame
            An array or tensor, a Pillow image, a path, bytes or an open file.

        Raises
        ------
        rollcast.errors.ClientError
            When the session is over.
        TypeError, ValueError, OSError
            When the frame cannot be converted or read; nothing is sent.
        """
        socket = self._opened()
        data = await to_thread(encoded, frame, self._crop, self._channels)
        with self._call.translated(self._timeout_s):
            async with within(Deadline(self._timeout_s)):
                self._sent += 1  # from here on it is in the connection's buffer
                await socket.send(data)
        return self._sent

    async def receive(self, timeout_s: float | None = None) -> TickAnswer:
        """Return the next answer.

        Parameters
        ----------
        timeout_s
            Longest wait, seconds; by default that of the client.

        Raises
        ------
        rollcast.errors.RequestTimeoutError
            When no answer arrives in time. The session goes on.
        rollcast.errors.ClientError
            When the session is over.
        """
        socket = self._opened()
        limit_s = self._timeout_s if timeout_s is None else checked_timeout(timeout_s)
        deadline = Deadline(limit_s)
        with self._call.translated(limit_s):
            async with within(deadline):
                return self._call.take(await socket.receive(deadline))

    async def newest(self) -> TickAnswer | None:
        """Return the newest answer that has arrived and drop older ones, without waiting.

        Forecasts and refusals go before answers with the status ``collecting`` or ``superseded``.
        None when nothing has arrived since the last call.

        Raises
        ------
        rollcast.errors.ClientError
            When the session is over.
        """
        socket = self._opened()
        answers: list[TickAnswer] = []
        with self._call.translated(self._timeout_s):
            while (text := await socket.received()) is not None:
                answers.append(self._call.take(text))
        return newest_of(answers)

    async def close(self) -> None:
        """End the session; a forecast that is being computed is cancelled."""
        socket, self._socket = self._socket, None
        if socket is not None:
            await socket.close()

    async def __aenter__(self) -> Self:
        deadline = Deadline(self._timeout_s)
        with self._call.translated(self._timeout_s):
            async with within(deadline):
                self._socket = await with_retries(
                    partial(self._open, deadline), self._retries, deadline
                )
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    async def _open(self, deadline: Deadline) -> "Socket | _LocalSocket":
        """Connect, and have the options accepted."""
        self._call.begin()
        with self._call.translated(self._timeout_s):
            if self._transport is None:
                url, options = str(self._call.url), self._call.options()
                socket = await Socket.open(url, options, deadline)
            else:
                socket = _LocalSocket(self._transport.open_session(self._call.first_message))
            try:
                await socket.send(self._call.first_message)
                self._call.take(await socket.receive(deadline))
            except BaseException:
                await socket.close()
                raise
        return socket

    def _opened(self) -> "Socket | _LocalSocket":
        if self._socket is None:
            raise RuntimeError("the session is not open: use it as a context manager")
        return self._socket


class _LocalSocket:
    """The connection to a session without a network."""

    def __init__(self, session: LocalSession) -> None:
        self._session = session

    async def send(self, message: str | bytes) -> None:
        self._session.send(message)

    async def receive(self, deadline: Deadline) -> str | bytes:
        """Return the next answer; without one, none will come."""
        if (answer := self._session.receive()) is None:
            raise TimeoutError(f"{float(deadline):g} s")
        return answer

    async def received(self) -> str | bytes | None:
        return self._session.receive()

    async def close(self) -> None:
        pass
