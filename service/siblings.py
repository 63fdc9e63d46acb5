"""One of the processes that answer on one address: its connections, and changes of models.

Both come from the process that has started them all (``service.processes``), over a pair of sockets
that carries a JSON array a line, and connections beside it.
"""

import asyncio
import json
import socket
import time
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from multiprocessing.sharedctypes import RawArray
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # it reads its variables when it is imported: not before they are set
    from prometheus_client import Gauge

MOST_CONNECTIONS = 64
"""That are taken over at once."""
LONGEST_READ = 64 * 1024
PAUSE_S = 0.004
"""For which a core does not count as idle: clients that ask without a pause need less between an
answer and the next request."""


class Service(NamedTuple):
    """What a process does with what it is sent.

    Attributes
    ----------
    accept
        Serves a connection.
    change
        Changes its models: what is done, ``load`` or ``unload``, and a model's name.
    stop
        Ends it.
    """

    accept: Callable[[socket.socket], Coroutine[None, None, None]]
    change: Callable[[str, str], Coroutine[None, None, None]]
    stop: Callable[[], None]


class Board:
    """Figures in memory that all processes share; each writes in its own place alone.

    Parameters
    ----------
    processes
        How many answer.
    """

    def __init__(self, processes: int) -> None:
        self.held = RawArray("l", processes)
        """Forecasts that are computed or wait."""
        self.resting_since = RawArray("d", processes)
        """When the last of them ended, seconds of the monotonic clock."""
        self.closed = RawArray("l", processes)
        """Connections that have ended."""


class Siblings:
    """The others, as one of them knows them.

    Parameters
    ----------
    place
        Its own on the board.
    channel
        To the process that has started it.
    board
        Shared by all.
    proves
        Which models it proves: of so many processes, those of the n-th.
    """

    def __init__(
        self, place: int, channel: socket.socket, board: Board, proves: tuple[int, int]
    ) -> None:
        self.proves = proves
        self._place = place
        self._channel = channel
        self._board = board
        self._begun = asyncio.Event()
        self._refused: dict[str, str] = {}
        self._text = b""
        self._connections: deque[int] = deque()
        self._asked: deque[asyncio.Future[None]] = deque()
        self._outcome: BaseException | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def one_rests(self) -> bool:
        """Whether one of the others has computed no forecast for a while: its core is idle."""
        now = time.monotonic()
        return any(
            held == 0 and now - since > PAUSE_S
            for place, (held, since) in enumerate(
                zip(self._board.held, self._board.resting_since, strict=True)
            )
            if place != self._place
        )

    def follow(self, shown: "Gauge") -> "Held":
        """Return a gauge of the forecasts held here that the others see too."""
        return Held(shown, self._board, self._place)

    def closed(self) -> None:
        """Count a connection that has ended."""
        self._board.closed[self._place] += 1

    def listen(self, service: Service) -> None:
        """Take over connections and changes from now on, until nobody sends them any more."""
        self._channel.setblocking(False)
        asyncio.get_running_loop().add_reader(self._channel, self._read, service)

    async def ready(self, refused: Mapping[str, str]) -> Mapping[str, str]:
        """Say that the models are there, and wait until all processes have theirs.

        Parameters
        ----------
        refused
            Reasons by NAME@VERSION.

        Returns
        -------
        Mapping
            Those of all processes.
        """
        self._say("ready", refused)
        await self._begun.wait()
        return self._refused

    async def everywhere(self, change: str, name: str) -> None:
        """Change a model in all processes; raises what the change raises in this one."""
        done = asyncio.get_running_loop().create_future()
        self._asked.append(done)
        self._say(change, name)
        await done

    def _say(self, *words: object) -> None:
        self._channel.sendall(line(*words))

    def _read(self, service: Service) -> None:
        try:
            data, handles, *_ = socket.recv_fds(self._channel, LONGEST_READ, MOST_CONNECTIONS)
        except BlockingIOError:
            return
        except OSError:
            data, handles = b"", []
        if not data:
            asyncio.get_running_loop().remove_reader(self._channel)
            service.stop()
            return
        self._connections.extend(handles)
        *lines, self._text = (self._text + data).split(b"\n")
        for text in lines:
            match json.loads(text):
                case ["connection"] if self._connections:
                    self._do(self._take(self._connections.popleft(), service))
                case ["connection"]:  # closed by the system: no descriptor was left for it
                    self.closed()
                case ["begin", refused]:
                    self._refused = refused
                    self._begun.set()
                case ["done"]:
                    self._answer()
                case [change, name, is_own]:
                    self._do(self._apply(change, name, is_own, service))
                case other:
                    raise ValueError(other)

    def _do(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _take(self, descriptor: int, service: Service) -> None:
        connection = socket.socket(fileno=descriptor)
        try:
            await service.accept(connection)
        except OSError:  # its client has gone
            connection.close()
            self.closed()

    async def _apply(self, change: str, name: str, is_own: bool, service: Service) -> None:
        try:
            await service.change(change, name)
        except Exception as error:  # is raised where the change was asked for
            if is_own:
                self._outcome = error
        self._say("did")

    def _answer(self) -> None:
        """Tell whoever has waited longest that all processes have changed their models."""
        done, error = self._asked.popleft(), self._outcome
        self._outcome = None
        with suppress(asyncio.InvalidStateError):  # its client has gone
            if error is None:
                done.set_result(None)
            else:
                done.set_exception(error)


class Held:
    """A gauge that also counts on the board.

    Parameters
    ----------
    shown
        The gauge.
    board, place
        Where it counts.
    """

    def __init__(self, shown: "Gauge", board: Board, place: int) -> None:
        self._shown = shown
        self._board = board
        self._place = place

    def inc(self) -> None:
        """Count one more."""
        self._shown.inc()
        self._board.held[self._place] += 1

    def dec(self) -> None:
        """Count one less."""
        self._shown.dec()
        self._board.held[self._place] -= 1
        if self._board.held[self._place] == 0:
            self._board.resting_since[self._place] = time.monotonic()


def line(*words: object) -> bytes:
    """Return a line of the channel."""
    return json.dumps(words).encode() + b"\n"
