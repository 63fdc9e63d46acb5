"""Several processes that answer on one address, and the one that starts and stops them.

A process computes Python on one core at a time, so that one alone leaves a tenth of two cores
unused (decision 0130). This one accepts the connections and hands each to the process that
has the fewest, so that none waits while another rests. It imports little and has no threads, so
that it may fork at any time: a process that dies is replaced.
"""

import json
import multiprocessing
import os
import selectors
import signal
import socket
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

from service.settings import share_metrics
from service.siblings import Board, Siblings, line

STOPS = (signal.SIGTERM, signal.SIGINT)
GIVE_UP_S = 1.0
"""After which a process that does not read what it is sent is passed over."""
MEMORY = Path("/dev/shm")
"""Where figures are counted: on a disk that is full, writing one would end the process."""
NO_DESCRIPTORS_S = 0.1
"""Between tries to accept where no descriptor is free."""


class _Asked(NamedTuple):
    """A change of a model, and the process that has asked for it."""

    change: str
    name: str
    by: "_Process"


class _Process:
    """One that answers.

    Attributes
    ----------
    given
        Connections that it has been handed.
    begun
        Whether it has its models and forecasts with them.
    behind
        Changes of models that it has still to repeat before it begins.
    """

    def __init__(self, place: int, channel: socket.socket) -> None:
        self.place = place
        self.channel = channel
        self.given = 0
        self.begun = False
        self.behind = 0
        self._text = b""
        channel.settimeout(GIVE_UP_S)

    def say(self, *words: object) -> bool:
        """Send a line; return whether it was taken."""
        try:
            self.channel.sendall(line(*words))
        except OSError:
            return False
        return True

    def hand_over(self, connection: socket.socket) -> bool:
        """Hand a connection over; return whether it was taken."""
        try:
            socket.send_fds(self.channel, [line("connection")], [connection.fileno()])
        except OSError:
            return False
        self.given += 1
        return True

    def heard(self) -> list[list[Any]] | None:
        """Return what it has said; None when it is gone."""
        try:
            data = self.channel.recv(64 * 1024)
        except OSError:
            return None
        if not data:
            return None
        *lines, self._text = (self._text + data).split(b"\n")
        return [json.loads(text) for text in lines]


class Processes:
    """Processes that answer on one address.

    Parameters
    ----------
    count
        How many.
    run
        What each of them does until it is told to stop.
    listener
        The address.
    """

    def __init__(
        self, count: int, run: Callable[[Siblings], None], listener: socket.socket
    ) -> None:
        self._count = count
        self._run = run
        self._listener = listener
        self._board = Board(count)
        self._context = multiprocessing.get_context("fork")
        self._running: dict[_Process, BaseProcess] = {}
        self._selector = selectors.DefaultSelector()
        self._changes: deque[_Asked] = deque()
        self._awaited: set[_Process] = set()
        self._last: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self._have_begun = False
        self._stopping = False
        self._status = 0

    def serve(self) -> int:
        """Answer until told to stop (SIGTERM, SIGINT); return the exit code.

        A process that dies before all have begun ends it; one that dies later is replaced.
        """
        with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
            share_metrics(folder)
            for number in STOPS:
                signal.signal(number, self._stop)
            self._listener.setblocking(False)
            self._selector.register(self._listener, selectors.EVENT_READ)
            for place in range(self._count):
                self._start(place)
            while self._running:
                for key, _ in self._selector.select():
                    if key.fileobj is self._listener:
                        self._accept()
                    else:
                        self._hear(key.data)
        return self._status

    def _stop(self, *_: object) -> None:
        """Tell them all; told again, they wait no longer."""
        self._stopping = True
        for process in self._running.values():
            process.terminate()

    def _start(self, place: int) -> None:
        ours, theirs = socket.socketpair()
        self._board.held[place] = self._board.closed[place] = 0
        process = self._context.Process(target=self._become, args=(place, ours, theirs))
        # Until it is known here, and answers for itself there, a signal waits: it would be lost.
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        process.start()
        theirs.close()
        mine = _Process(place, ours)
        self._running[mine] = process
        self._selector.register(ours, selectors.EVENT_READ, mine)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        if self._stopping:
            process.terminate()

    def _become(self, place: int, ours: socket.socket, theirs: socket.socket) -> None:
        """Be one of them, with nothing of the others' left open."""
        for number in STOPS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        os.setpgrp()  # Ctrl-C is for the one that started it, which tells the others once
        for channel in (ours, self._listener, *(other.channel for other in self._running)):
            channel.close()
        self._selector.close()
        # What starts together shares the proofs out; who comes later proves all.
        proves = (0, 1) if self._have_begun else (place, self._count)
        self._run(Siblings(place, theirs, self._board, proves))

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        except OSError:  # no descriptor is free, or its client has gone
            time.sleep(NO_DESCRIPTORS_S)
            return
        with connection:
            for process in sorted(self._running, key=self._burden):
                if process.hand_over(connection):
                    return

    def _burden(self, process: _Process) -> tuple[bool, int]:
        """Sort those that do not forecast yet, and those with many connections, behind others."""
        return not process.begun, process.given - self._board.closed[process.place]

    def _hear(self, process: _Process) -> None:
        said = process.heard()
        if said is None:
            self._bury(process)
            return
        for words in said:
            match words:
                case ["ready", refused]:
                    self._ready(process, refused)
                case ["did"] if process.behind:
                    process.behind -= 1
                    self._catch_up(process)
                case ["did"]:
                    self._awaited.discard(process)
                    self._end_change()
                case [change, name]:
                    self._changes.append(_Asked(change, name, by=process))
                    self._begin_change()
                case other:
                    raise ValueError(other)

    def _ready(self, process: _Process, refused: Mapping[str, str]) -> None:
        """Let all begin at once, so that connections are shared out evenly from the first on."""
        if self._have_begun:
            # It has loaded what the folder holds, perhaps not what is served since.
            for name, change in self._last.items():
                process.say(change, name, False)
            process.behind = len(self._last)
            self._catch_up(process)
            return
        process.begun = True
        self._refused.update(refused)
        if len(self._running) == self._count and all(one.begun for one in self._running):
            self._have_begun = True
            for one in self._running:
                one.say("begin", self._refused)

    def _catch_up(self, process: _Process) -> None:
        """Let a process that replaces another begin once it serves what the others do."""
        if not process.behind:
            process.begun = True
            process.say("begin", {})
            self._begin_change()

    def _begin_change(self) -> None:
        """Tell everybody about the next change, unless one is going on: all see one order."""
        going_on = self._awaited or any(process.behind for process in self._running)
        if going_on or not self._changes:
            return
        change, name, by = self._changes[0]
        known = [one for one in self._running if one.begun]
        self._awaited = {one for one in known if one.say(change, name, one is by)}
        self._last[name] = change
        self._end_change()

    def _end_change(self) -> None:
        if self._awaited or not self._changes:
            return
        self._changes.popleft().by.say("done")
        self._begin_change()

    def _bury(self, process: _Process) -> None:
        self._selector.unregister(process.channel)
        process.channel.close()
        ended = self._running.pop(process)
        ended.terminate()
        ended.join()
        self._forget_figures(ended.pid)
        if process in self._awaited:
            self._awaited.discard(process)
            self._end_change()
        self._begin_change()
        if self._stopping:
            return
        if self._have_begun:
            self._start(process.place)
        else:  # it would fail again
            self._status = ended.exitcode or 1
            self._stop()

    def _forget_figures(self, pid: int | None) -> None:
        from prometheus_client.multiprocess import (
            mark_process_dead,  # pyright: ignore[reportUnknownVariableType]
        )

        with suppress(OSError):
            mark_process_dead(pid)
