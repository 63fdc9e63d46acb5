"""What a process does with what the one that started it sends, over a real pair of sockets."""

import asyncio
import socket
import time
from contextlib import closing

import pytest

from service.siblings import PAUSE_S, Board, Held, Service, Siblings, line


class Shown:
    """A gauge that nobody reads."""

    def inc(self):
        pass

    def dec(self):
        pass


@pytest.fixture
def board():
    return Board(2)


def test_a_connection_without_a_descriptor_is_counted_as_closed_and_the_next_one_answered(board):
    accepted: list[socket.socket] = []

    async def accept(connection):
        accepted.append(connection)

    async def change(what, name):
        raise AssertionError((what, name))

    async def run(ours, theirs):
        Siblings(1, ours, board, (0, 2)).listen(Service(accept, change, lambda: None))
        theirs.sendall(line("connection"))
        with socket.socket() as connection:
            socket.send_fds(theirs, [line("connection")], [connection.fileno()])
        while not accepted:
            await asyncio.sleep(0.01)
        asyncio.get_running_loop().remove_reader(ours)

    ours, theirs = socket.socketpair()
    with closing(ours), closing(theirs):
        asyncio.run(asyncio.wait_for(run(ours, theirs), 10))
    accepted[0].close()
    assert list(board.closed) == [0, 1]
    assert len(accepted) == 1


def test_a_core_rests_when_it_has_computed_nothing_for_a_while(board):
    ours, theirs = socket.socketpair()
    with closing(ours), closing(theirs):
        mine, other = Siblings(0, ours, board, (0, 2)), Held(Shown(), board, 1)
        assert mine.one_rests
        other.inc()
        assert not mine.one_rests
        ended = time.monotonic()
        other.dec()
        rests = mine.one_rests
        assert not rests or time.monotonic() - ended > PAUSE_S
        time.sleep(2 * PAUSE_S)
        assert mine.one_rests
