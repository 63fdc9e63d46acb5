"""What a real listener does with sessions that are slow, silent, deaf or too large."""

import json
import os
import struct
import threading
import time
from contextlib import contextmanager

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.service.process.test_connection_limits import (
    PATIENCE_S,
    TIMEOUT_S,
    connected,
    everything,
    exchange,
    reluctant,
    served,
    still_well,
)
from tests.service.samples import moving_dot

HANDSHAKE = (
    b"GET /stream HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
CONTINUATION, BINARY, CLOSE, PING = 0, 2, 8, 9


@contextmanager
def session(address, **options):
    host, port = address
    with connect(f"ws://{host}:{port}/stream", compression=None) as opened:
        opened.send(json.dumps(options))
        assert json.loads(opened.recv(PATIENCE_S))["status"] == "open"
        yield opened


def shake_hands(client):
    """Open a WebSocket over a socket, and its session."""
    client.sendall(HANDSHAKE)
    head = b""
    while not head.endswith(b"\r\n\r\n"):
        head += client.recv(1)
    assert head.startswith(b"HTTP/1.1 101 "), head
    client.sendall(piece(1, b'{"horizon": 1000}'))
    return client


def piece(kind: int, content: bytes, last: bool = True) -> bytes:
    """A frame of the protocol with a mask of zeros."""
    size = len(content)
    if size < 126:
        length = struct.pack("!B", 128 | size)
    elif size < 2**16:
        length = struct.pack("!BH", 128 | 126, size)
    else:
        length = struct.pack("!BQ", 128 | 127, size)
    return struct.pack("!B", (128 if last else 0) | kind) + length + bytes(4) + content


def sessions(address) -> float:
    text = exchange(address, b"GET /metrics HTTP/1.1").decode()
    (line,) = [line for line in text.splitlines() if line.startswith("rollcast_sessions ")]
    return float(line.split()[1])


def wait_for_the_end(address):
    """Wait until the service holds no session."""
    deadline = time.monotonic() + PATIENCE_S
    while sessions(address):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_time_limits_of_requests_end_with_the_upgrade(tmp_path):
    with served(tmp_path, read_timeout_s=TIMEOUT_S) as address, session(address) as opened:
        for frame in moving_dot():
            time.sleep(1.5 * TIMEOUT_S)
            opened.send(frame)
            answer = json.loads(opened.recv(PATIENCE_S))
        assert answer["status"] == "forecast"


def test_a_session_whose_first_message_is_late_is_refused(tmp_path):
    with served(tmp_path) as address, connect(f"ws://{address[0]}:{address[1]}/stream") as opened:
        answer = json.loads(opened.recv(PATIENCE_S))
        assert answer["problem"]["type"] == "/problems/body-too-slow"
        with pytest.raises(ConnectionClosed):
            opened.recv(PATIENCE_S)


def test_a_message_that_never_ends_is_given_up(tmp_path):
    with served(tmp_path) as address:
        with connected(address) as client:
            shake_hands(client)
            client.sendall(piece(BINARY, moving_dot()[0])[:-10])
            started = time.monotonic()
            everything(client)
            assert time.monotonic() - started < PATIENCE_S / 2
        wait_for_the_end(address)
        assert still_well(address)


def test_a_peer_that_answers_no_ping_is_given_up(tmp_path):
    with served(tmp_path, read_timeout_s=30) as address:
        with connected(address) as client:
            shake_hands(client)
            said = everything(client)
        assert bytes([128 | PING]) in said
        wait_for_the_end(address)


def test_a_client_that_reads_nothing_is_given_up(tmp_path):
    with served(tmp_path, read_timeout_s=30) as address:
        with reluctant(address) as client:
            shake_hands(client)
            with pytest.raises(OSError):  # noqa: PT011, PT012 - reset, or a broken pipe
                for _ in range(10_000):
                    for frame in moving_dot():
                        client.sendall(piece(BINARY, frame))
                        time.sleep(0.001)
        wait_for_the_end(address)
        assert still_well(address)


def test_a_client_that_only_pings_and_reads_nothing_is_given_up(tmp_path):
    with served(tmp_path, read_timeout_s=30, write_timeout_s=30) as address:
        with reluctant(address) as client:
            shake_hands(client)
            with pytest.raises(OSError):  # noqa: PT011, PT012 - reset, or a broken pipe
                for _ in range(100_000):
                    client.sendall(piece(PING, bytes(125)) * 100)
        wait_for_the_end(address)


def test_a_message_that_is_too_large_ends_its_session_alone(tmp_path):
    with served(tmp_path, max_body_bytes=100_000) as address, session(address) as other:
        with session(address) as opened:
            opened.send(os.urandom(100_001))
            with pytest.raises(ConnectionClosed) as closed:
                opened.recv(PATIENCE_S)
            assert closed.value.rcvd.code == 1009
        other.send(moving_dot()[0])
        assert json.loads(other.recv(PATIENCE_S))["status"] == "collecting"


def test_a_message_in_tiny_pieces_counts_what_they_take(tmp_path):
    with served(tmp_path, max_body_bytes=2**20, read_timeout_s=30, write_timeout_s=30) as address:
        with connected(address) as client:
            shake_hands(client)
            reader = threading.Thread(target=everything, args=[client], daemon=True)
            reader.start()
            with pytest.raises(OSError):  # noqa: PT011, PT012 - reset, or a broken pipe
                client.sendall(piece(BINARY, b"x", last=False))
                for _ in range(1000):
                    client.sendall(piece(CONTINUATION, b"x", last=False) * 1000)
            reader.join(PATIENCE_S)  # before its socket is closed
        wait_for_the_end(address)
        assert still_well(address)


def test_a_frame_in_several_pieces_is_read(tmp_path):
    with served(tmp_path, read_timeout_s=30) as address, session(address, horizon=1) as opened:
        for frame in moving_dot():
            opened.send([frame[:100], frame[100:200], frame[200:]])
            answer = json.loads(opened.recv(PATIENCE_S))
        assert answer["status"] == "forecast"


def test_messages_that_arrive_count_in_the_budget_of_bodies(tmp_path):
    limits = {"max_body_bytes": 2**20, "max_total_body_bytes": 3 * 2**20}
    with served(tmp_path, read_timeout_s=30, write_timeout_s=30, **limits) as address:
        clients = [shake_hands(connected(address)) for _ in range(8)]
        for client in clients:
            client.sendall(piece(BINARY, bytes(2**20))[:-1])
        deadline = time.monotonic() + PATIENCE_S
        while sessions(address) > 3:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        for client in clients:
            client.close()
        wait_for_the_end(address)
        with session(address) as opened:
            opened.send(moving_dot()[0])
            assert json.loads(opened.recv(PATIENCE_S))["status"] == "collecting"


def test_unanswered_frames_are_limited(tmp_path):
    """Far more frames than the service answers at a time: all of them are answered, in order."""
    frame = moving_dot(32)[0]
    with served(tmp_path, read_timeout_s=30, write_timeout_s=30) as address:
        with session(address, horizon=1) as opened:

            def send():
                for _ in range(3000):
                    opened.send(frame)

            sender = threading.Thread(target=send)
            sender.start()
            ticks = [json.loads(opened.recv(PATIENCE_S))["tick"] for _ in range(3000)]
            sender.join()
        assert ticks == list(range(1, 3001))


@pytest.mark.parametrize("path", ["/predict", "/nowhere"])
def test_no_other_route_is_a_websocket(tmp_path, path):
    with served(tmp_path) as address, connected(address) as client:
        client.sendall(HANDSHAKE.replace(b"/stream", path.encode()))
        assert everything(client).startswith(b"HTTP/1.1 403 ")


def test_a_handshake_that_is_none_is_refused(tmp_path):
    upgrade = (
        b"GET /stream HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n"
    )
    with served(tmp_path) as address:
        with connected(address) as client:
            client.sendall(upgrade)
            assert everything(client).startswith(b"HTTP/1.1 4")
        assert exchange(address, b"GET /stream HTTP/1.1").startswith(b"HTTP/1.1 404 ")


def test_a_handshake_names_no_software(tmp_path):
    with served(tmp_path) as address, connected(address) as client:
        client.sendall(HANDSHAKE)
        head = client.recv(4096).lower()
    assert head.startswith(b"http/1.1 101")
    assert b"x-request-id: " in head
    assert b"server:" not in head
    assert b"python" not in head
