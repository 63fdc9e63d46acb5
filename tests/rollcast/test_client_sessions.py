"""Sessions with servers that do not behave: both clients raise what is documented, in time."""

import json
import socket
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from websockets.sync.server import serve

from rollcast.client import Client
from rollcast.client.testing import FakeService
from rollcast.errors import (
    AuthError,
    BadRequestError,
    RequestTimeoutError,
    ServerError,
    UnexpectedAnswerError,
    UnreachableError,
)
from tests.rollcast.clients import PROBLEM, Awaiting

FRAME = np.zeros((64, 64, 3), np.uint8)
OPEN = json.dumps({"tick": 0, "status": "open", "latency_ms": 0.1})
COLLECTING = {"tick": 1, "status": "collecting", "latency_ms": 0.1}


@pytest.fixture(params=[Client, Awaiting], ids=["blocking", "awaited"])
def kind(request):
    return request.param


@contextmanager
def serving(handler=None, refuse=None):
    """A WebSocket server, whose handler gets the connection; or which refuses every handshake."""
    with serve(
        handler, "127.0.0.1", 0, process_request=refuse, compression=None, close_timeout=0.2
    ) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def session_with(kind, handler, refuse=None, **options):
    """An open session with such a server."""
    with (
        serving(handler, refuse) as url,
        kind(url, retries=0, **options) as client,
        client.session() as session,
    ):
        yield session


def saying(*answers):
    """Answer the first message and every frame with the next of some texts."""

    def handle(connection):
        for answer in answers:
            connection.recv()
            connection.send(answer)
        connection.recv()

    return handle


def refusing(status, body=b"", headers=()):
    def refuse(connection, request):
        response = connection.respond(status, body.decode())
        del response.headers["Content-Type"]
        for name, value in headers:
            response.headers[name] = value
        return response

    return refuse


WRONG = {
    "no JSON": "hello",
    "bytes": b"\xff\xfe",
    "another tick": json.dumps(COLLECTING | {"tick": 2}),
    "the same tick": OPEN,
    "no status": json.dumps({"tick": 1}),
    "an unknown status": json.dumps(COLLECTING | {"status": "perhaps"}),
    "no forecast": json.dumps(COLLECTING | {"status": "forecast"}),
    "no problem": json.dumps(COLLECTING | {"status": "refused"}),
    "half a forecast": json.dumps(COLLECTING | {"status": "forecast", "forecast": {"model": 1}}),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_answers_are_named(kind, case):
    with session_with(kind, saying(OPEN, WRONG[case])) as session:
        session.send(FRAME)
        with pytest.raises(UnexpectedAnswerError, match="cannot be read"):
            session.receive()


def test_a_forecast_of_other_steps_is_none(kind):
    with Client(transport=FakeService()) as client, client.session(horizon=3) as session:
        for _ in range(4):
            session.send(FRAME)
        forecast = json.loads(session.newest().forecast.to_json())
    answer = json.dumps(COLLECTING | {"status": "forecast", "forecast": forecast})
    with serving(saying(OPEN, answer)) as url, kind(url) as client:
        with client.session(horizon=3) as session:
            session.send(FRAME)
            assert session.receive().forecast.positions.shape == (1, 3, 2)
        with client.session(horizon=5) as session:
            session.send(FRAME)
            with pytest.raises(UnexpectedAnswerError, match="3 steps instead of 5"):
                session.receive()


def test_unknown_fields_of_a_newer_service_are_left_out(kind):
    answer = json.dumps(COLLECTING | {"more": 1})
    with session_with(kind, saying(OPEN, answer)) as session:
        session.send(FRAME)
        assert session.receive().status == "collecting"


def test_an_answer_that_is_too_large_ends_the_session(kind):
    with session_with(kind, saying(OPEN, "x" * (17 * 2**20))) as session:
        session.send(FRAME)
        with pytest.raises(UnreachableError, match="1009"):
            session.receive()


@pytest.mark.parametrize("retries", [0, 2])
def test_a_handshake_is_retried_while_the_service_is_not_ready(kind, retries):
    document = json.dumps(PROBLEM | {"status": 503}).encode()
    asked = []

    def refuse(connection, request):
        asked.append(request.headers["X-Request-ID"])
        return None if len(asked) > 2 else refusing(503, document)(connection, request)

    with serving(saying(OPEN), refuse) as url, kind(url, retries=retries) as client:
        if retries:
            with client.session():
                pass
        else:
            with pytest.raises(ServerError) as refused, client.session():
                pass
            assert refused.value.request_id == asked[0]
    assert len(asked) == 1 + retries
    assert len(set(asked)) == 1


HANDSHAKES = {
    "unauthorised": (401, AuthError, "401"),
    "not found": (404, BadRequestError, "proxy does not pass WebSockets on"),
    "wrong": (422, BadRequestError, "expected more"),
}


@pytest.mark.parametrize("case", HANDSHAKES)
def test_a_refused_handshake_is_its_problem(kind, case):
    status, expected, message = HANDSHAKES[case]
    document = json.dumps(PROBLEM | {"status": status}).encode()
    with (
        pytest.raises(expected, match=message) as refused,
        session_with(kind, None, refusing(status, document)),
    ):
        pass
    assert refused.value.status_code == status


def test_another_program_is_named(kind):
    refuse = refusing(200, b"<html>hello</html>")
    with pytest.raises(UnexpectedAnswerError), session_with(kind, None, refuse):
        pass


@contextmanager
def bare_server(reply):
    """A listener that says something to every connection."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept():
            try:
                while True:
                    connection, _ = listener.accept()
                    kept.append(connection)
                    if reply:
                        connection.sendall(reply)
                        connection.close()
            except OSError:
                return

        kept = []
        thread = threading.Thread(target=accept)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()
            for connection in kept:
                connection.close()


def test_something_that_is_not_http_is_named(kind):
    # Its first bytes and its end race with the request: each order must be named the same.
    with bare_server(b"SSH-2.0-OpenSSH\r\n\r\n") as url, kind(url, timeout_s=10) as client:
        for _ in range(20):
            with pytest.raises(UnexpectedAnswerError, match="opens no session"), client.session():
                pass


def test_a_handshake_without_an_answer_ends_in_time(kind):
    with bare_server(b"") as url, kind(url, timeout_s=0.3) as client:
        begun = time.monotonic()
        with pytest.raises(RequestTimeoutError), client.session():
            pass
        assert time.monotonic() - begun < 5


def test_options_without_an_answer_end_in_time(kind):
    def silent(connection):
        connection.recv()
        connection.recv()

    with serving(silent) as url, kind(url, timeout_s=0.3) as client:
        begun = time.monotonic()
        with pytest.raises(RequestTimeoutError), client.session():
            pass
        assert time.monotonic() - begun < 5


def test_a_wait_has_its_own_limit_and_the_session_goes_on(kind):
    def slow(connection):
        saying(OPEN)(connection)
        time.sleep(0.3)
        connection.send(json.dumps(COLLECTING))
        connection.recv()

    with session_with(kind, slow) as session:
        session.send(FRAME)
        with pytest.raises(RequestTimeoutError, match=r"0\.05 s"):
            session.receive(timeout_s=0.05)
        assert session.newest() is None
        assert session.receive(timeout_s=5).status == "collecting"


def test_a_service_that_reads_nothing_ends_the_session_in_time(kind):
    stop = threading.Event()

    def deaf(connection):
        connection.recv()
        connection.send(OPEN)
        stop.wait(30)

    large = np.random.default_rng(1).integers(0, 256, (1024, 1024, 3), np.uint8)

    def send_all(session):
        for _ in range(1000):
            session.send(large)

    begun = time.monotonic()
    with session_with(kind, deaf, timeout_s=0.5) as session:
        with pytest.raises(UnreachableError):
            send_all(session)
        stop.set()
    assert time.monotonic() - begun < 60


@pytest.mark.parametrize("code", [1000, 1011, 1012])
def test_a_closed_session_is_over(kind, code):
    def closing(connection):
        saying(OPEN)(connection)
        connection.close(code)

    with session_with(kind, closing) as session:
        session.send(FRAME)
        with pytest.raises(UnreachableError, match=str(code)) as ended:
            session.receive()
        assert ended.value.request_id is not None
        for _ in range(2):
            with pytest.raises(UnreachableError):
                session.newest()
        with pytest.raises(UnreachableError):
            session.send(FRAME)


def test_a_path_and_a_key_are_sent(kind):
    seen = []

    def note(connection, request):
        seen.append((request.path, request.headers["Authorization"]))

    with (
        serving(saying(OPEN), note) as url,
        kind(f"{url}/lab/", api_key="secret") as client,
        client.session(),
    ):
        pass
    assert seen == [("/lab/stream", "Bearer secret")]
