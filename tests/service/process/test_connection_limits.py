"""What a real listener does with clients that are slow, that never end or that never read."""

import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from service.process.connection_limits import MAX_HEAD_BYTES
from service.process.server import make_server
from service.settings import Settings
from tests.service import samples
from tests.service.samples import body

TIMEOUT_S = 0.3
PATIENCE_S = 5.0
"""Far more than the service takes for any of this."""


@contextmanager
def served(folder, load=samples.registry, **limits: object) -> Iterator[tuple[str, int]]:
    """The service on a port of its own, in a thread."""
    limits = {"read_timeout_s": TIMEOUT_S, "write_timeout_s": TIMEOUT_S} | limits
    settings = Settings(models_dir=folder, graceful_shutdown_timeout_s=1, **limits)
    log = logging.getLogger()
    level, handlers = log.level, [*log.handlers]
    server = make_server(settings, load)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDBUF, 4096
        )  # its connections have it too
        thread = threading.Thread(target=server.run, args=([listener],))
        thread.start()
        address = listener.getsockname()
        try:
            while b'"ready"' not in exchange(address, b"GET /health/ready HTTP/1.1"):
                time.sleep(0.01)
            yield address
        finally:
            server.should_exit = True
            thread.join()
            # A server sets up the log of its whole process, which others of these tests read.
            log.setLevel(level)
            log.handlers[:] = handlers


@pytest.fixture
def address(tmp_path) -> Iterator[tuple[str, int]]:
    with served(tmp_path) as address:
        yield address


def exchange(address: tuple[str, int], head: bytes, content: bytes = b"") -> bytes:
    with connected(address) as client:
        client.sendall(head + b"\r\nHost: a\r\nConnection: close\r\n\r\n" + content)
        return everything(client)


def connected(address: tuple[str, int]) -> socket.socket:
    return socket.create_connection(address, timeout=PATIENCE_S)


def reluctant(address: tuple[str, int]) -> socket.socket:
    """A connection that hardly anything fits into."""
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.settimeout(PATIENCE_S)
    client.connect(address)
    return client


def everything(client: socket.socket) -> bytes:
    """What comes until the service closes the connection."""
    pieces = []
    try:
        while piece := client.recv(65536):
            pieces.append(piece)
    except ConnectionResetError:
        pass
    return b"".join(pieces)


def post(content: bytes, length: int | None = None) -> bytes:
    announced = len(content) if length is None else length
    return (
        b"POST /predict HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n\r\n%b" % (announced, content)
    )


def still_well(address: tuple[str, int]) -> bool:
    return b" 200 OK" in exchange(address, b"GET /health/live HTTP/1.1")


@pytest.mark.parametrize(
    "begun",
    [b"", b"\r\n", b"GET /health/live HTTP/1.1\r\nHost:", b"GET / HTTP/1.1\r\nHost: a\r\n"],
    ids=["nothing", "an empty line", "half a header", "no last line"],
)
def test_a_request_that_never_begins_or_ends_is_given_up(address, begun):
    with connected(address) as client:
        client.sendall(begun)
        started = time.monotonic()
        assert everything(client) == b""
        assert time.monotonic() - started < 4 * TIMEOUT_S
    assert still_well(address)


def test_an_empty_line_after_an_answer_gains_no_time(address):
    with connected(address) as client:
        client.sendall(b"GET /health/live HTTP/1.1\r\nHost: a\r\n\r\n")
        assert b"live" in client.recv(65536)
        client.sendall(b"\r\n")
        assert everything(client) == b""


@pytest.mark.parametrize(
    ("kind", "begun"),
    [("application/json", b"{"), ("multipart/form-data; boundary=b", b"--b\r\n")],
)
def test_a_body_that_comes_too_slowly_is_408(address, kind, begun):
    head = f"POST /predict HTTP/1.1\r\nHost: a\r\nContent-Type: {kind}\r\nContent-Length: 99\r\n"
    with connected(address) as client:
        client.sendall(head.encode() + b"\r\n" + begun)
        time.sleep(TIMEOUT_S / 2)
        client.sendall(b"C")
        answer = everything(client)
    status, _, content = answer.partition(b"\r\n\r\n")
    assert status.startswith(b"HTTP/1.1 408 "), answer
    assert json.loads(content)["type"] == "/problems/body-too-slow"
    assert still_well(address)


def test_a_body_shorter_than_announced_is_given_up_when_the_client_goes(address):
    with connected(address) as client:
        client.sendall(post(b"{}", length=10))
        client.shutdown(socket.SHUT_WR)
        assert b" 200 " not in everything(client)
    assert still_well(address)


def test_a_body_longer_than_announced_closes_the_connection(address):
    content = json.dumps(body(horizon=1)).encode()
    with connected(address) as client:
        client.sendall(post(content + b"rubbish", length=len(content)))
        answer = everything(client)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert still_well(address)


@pytest.mark.parametrize("length", [b"-1", b"1e3", b"9" * 30, b"5\r\nContent-Length: 6", b"x"])
def test_a_length_that_is_none_is_refused(address, length):
    head = b"POST /predict HTTP/1.1\r\nContent-Length: " + length
    assert exchange(address, head).startswith(b"HTTP/1.1 400 ")
    assert still_well(address)


def test_headers_without_end_are_cut_off(address):
    with connected(address) as client:
        endless = b"GET / HTTP/1.1\r\n" + b"X-A: b\r\n" * (25 * MAX_HEAD_BYTES)
        with pytest.raises((ConnectionResetError, BrokenPipeError)):
            client.sendall(endless)
    assert still_well(address)


@pytest.mark.parametrize("path", ["/predict", "/predict/stream"])
def test_an_answer_that_nobody_takes_is_given_up(address, path):
    """Its connection is closed, and with it the memory of what it would have been sent."""
    content = json.dumps(body(horizon=1000)).encode()
    asked = post(content).replace(b"/predict", path.encode())
    with reluctant(address) as client:
        client.sendall(asked)
        time.sleep(3 * TIMEOUT_S)
        assert still_well(address)
        taken = everything(client)
    assert taken.startswith(b"HTTP/1.1 200 ")
    assert len(taken) < 50_000


def test_a_client_that_reads_slowly_gets_its_whole_answer(address):
    content = json.dumps(body(horizon=1000)).encode()
    with reluctant(address) as client:
        client.sendall(post(content).replace(b"Host: a", b"Host: a\r\nConnection: close"))
        started, answer = time.monotonic(), b""
        while piece := client.recv(4096):
            answer += piece
            time.sleep(0.1)
        assert time.monotonic() - started > 2 * TIMEOUT_S
    assert len(json.loads(answer.partition(b"\r\n\r\n")[2])["times_s"]) == 1000


def test_no_answer_names_the_software(address):
    for head in (b"GET /health/live HTTP/1.1", b"GET /nowhere HTTP/1.1", b"nonsense"):
        answer = exchange(address, head).lower()
        assert answer.startswith(b"http/1.1 ")
        assert b"server:" not in answer
        assert b"uvicorn" not in answer
        assert b"python" not in answer


CHUNKED = (
    b"POST /predict HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
    b"Transfer-Encoding: chunked\r\n\r\n"
)


@pytest.mark.parametrize("path", [b"/predict", b"/health/live", b"/nothing"])
@pytest.mark.parametrize(
    ("begin", "piece"),
    [
        (b"2\r\n{}\r\n0\r\n", b"x-a: " + b"y" * 10_000 + b"\r\n"),
        (b"2\r\n{}\r\n0\r\nx-a: ", b"y" * 10_000),
        (b"2;", b"y" * 10_000),
        (b"", b"1;a=" + b"y" * 10_000 + b"\r\n \r\n"),
    ],
    ids=["trailers", "a long trailer", "a long extension", "extensions"],
)
def test_what_is_no_body_is_limited(tmp_path, path, begin, piece):
    with served(tmp_path, read_timeout_s=30) as address, connected(address) as client:
        with pytest.raises(OSError):  # noqa: PT011, PT012 - reset, or a broken pipe
            client.sendall(CHUNKED.replace(b"/predict", path) + begin)
            for _ in range(2000):
                client.sendall(piece)
        assert b'"live"' in exchange(address, b"GET /health/live HTTP/1.1")


def test_a_body_in_tiny_chunks_is_read(tmp_path):
    content = json.dumps(body(horizon=1)).encode()
    chunks = b"".join(b"1\r\n" + content[at : at + 1] + b"\r\n" for at in range(len(content)))
    with served(tmp_path, read_timeout_s=30) as address, connected(address) as client:
        head = CHUNKED.replace(b"Host: a", b"Host: a\r\nConnection: close")
        client.sendall(head + chunks + b"0\r\nx-trailer: some\r\n\r\n")
        assert everything(client).startswith(b"HTTP/1.1 200")
