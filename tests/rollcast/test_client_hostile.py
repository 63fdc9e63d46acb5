"""Both clients against servers that answer wrongly: whatever comes, a ClientError or a result."""

import asyncio
import gc
import json
import random
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager

import httpx2
import numpy as np
import pytest

from rollcast.client import AsyncClient, Client, Forecast, Simulation
from rollcast.errors import (
    ClientError,
    InvalidArgumentError,
    OverloadedError,
    RequestTimeoutError,
    ServerError,
    UnexpectedAnswerError,
    UnreachableError,
)
from tests.rollcast.answers import ANSWERS, CALLS, FRAMES, HORIZON
from tests.rollcast.clients import Awaiting, problem
from tests.rollcast.hostile_server import ALWAYS, SPOILED, STREAMS

TIMEOUT_S = 1.0
GRACE_S = 10.0
"""Time beyond the timeout that a busy machine may take."""
SLOW = [way for way in ALWAYS if way.startswith(("slow-", "silent"))]
HARMLESS = {"wrong-kind"}
"""Ways whose answers are valid nevertheless, but for streams."""
STREAM = "/predict/stream"
NO_STREAM = (STREAM, "slow-body")
KINDS = pytest.mark.parametrize("kind", [Client, Awaiting], ids=["blocking", "awaited"])


@pytest.fixture(scope="module")
def address():
    command = [sys.executable, "-m", "tests.rollcast.hostile_server"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        yield f"http://127.0.0.1:{int(server.stdout.readline())}"
        server.kill()


@contextmanager
def in_time(limit_s):
    begun = time.monotonic()
    yield
    assert time.monotonic() - begun < limit_s + GRACE_S


@KINDS
@pytest.mark.parametrize("way", [way for way in [*ALWAYS, *SPOILED] if way not in SLOW])
def test_a_wrong_answer_is_an_error_of_the_documented_tree(address, kind, way):
    with kind(f"{address}/{way}", timeout_s=10, retries=0) as client:
        for path, call in CALLS.items():
            if way in HARMLESS and path != STREAM:
                call(client)
                continue
            with in_time(10), pytest.raises(ClientError) as caught:
                call(client)
            assert f"{way}{path}" in str(caught.value) or isinstance(caught.value, ServerError)
            assert caught.value.request_id


@KINDS
@pytest.mark.parametrize("way", STREAMS)
def test_a_wrong_stream_is_one_too(address, kind, way):
    endless = {"comments", "comments-flood", "news-flood", "comments-after-a-step"}
    expected = RequestTimeoutError if way in endless else UnexpectedAnswerError
    with (
        kind(f"{address}/{way}", timeout_s=TIMEOUT_S if way in endless else 10) as client,
        in_time(10),
        pytest.raises(expected),
    ):
        CALLS[STREAM](client)


@KINDS
@pytest.mark.parametrize(
    ("path", "way"),
    # A body that is no stream is not waited for.
    [(path, way) for path in ("/models", STREAM) for way in SLOW if (path, way) != NO_STREAM],
)
def test_no_answer_takes_longer_than_the_timeout(address, kind, way, path):
    with (
        kind(f"{address}/{way}", timeout_s=TIMEOUT_S, retries=5) as client,
        in_time(TIMEOUT_S),
        pytest.raises(RequestTimeoutError, match="did not answer within 1 s"),
    ):
        CALLS[path](client)


@KINDS
@pytest.mark.parametrize("way", ["announced-huge", "flood", "gzip-bomb"])
def test_an_answer_of_300_mb_is_refused_while_it_arrives(address, kind, way):
    with kind(f"{address}/{way}", timeout_s=60, retries=0) as client:
        with pytest.raises(UnexpectedAnswerError, match="more than the 16 MiB") as caught:
            client.predict(FRAMES)
        assert caught.value.status_code == 200
        if kind is Client and way == "announced-huge":
            with pytest.raises(UnexpectedAnswerError, match="more than the 256 MiB"):
                client.simulate("ellipsoid", seed=1)


@KINDS
def test_nobody_sleeps_for_a_billion_seconds(address, kind):
    with (
        kind(f"{address}/retry-in-a-billion", retries=5) as client,
        in_time(0),
        pytest.raises(ServerError) as caught,
    ):
        client.models()
    assert caught.value.retry_after_s == 1e9
    assert caught.value.status_code == 503
    assert len(caught.value.request_id) == 32


def test_a_longer_wait_than_the_timeout_is_not_begun(client):
    asked = []

    def answer(request):
        asked.append(request)
        return problem(429, {"retry-after": "59"})

    with in_time(0), pytest.raises(OverloadedError) as caught:
        client(httpx2.MockTransport(answer), retries=3, timeout_s=30).models()
    assert caught.value.retry_after_s == 59
    assert len(asked) == 1


def test_a_stream_may_be_read_slowly(client):
    connected = client(httpx2.MockTransport(_valid), timeout_s=0.5)
    stream = connected.predict_stream(FRAMES, horizon=HORIZON, num_objects=2)
    for step in stream:
        time.sleep(0.3 if step.step < 3 else 0)  # 0.9 s in all
    assert stream.forecast.positions.shape == (2, HORIZON, 2)


def test_the_identifier_is_that_of_the_answer(client):
    def answer(request):
        return problem(422, {"x-request-id": "of-the-log"})

    with pytest.raises(ClientError) as caught:
        client(httpx2.MockTransport(answer)).models()
    assert (caught.value.request_id, caught.value.status_code) == ("of-the-log", 422)


WRONG = {
    "a model's name": lambda client: client.predict(FRAMES, model="\ud800"),
    "a name to look up": lambda client: client.model("\udfff"),
    "no whole number": lambda client: client.predict(FRAMES, horizon=2.5),
    "no seed": lambda client: client.simulate("ellipsoid", seed="seven"),
    "no number": lambda client: client.predict(FRAMES, frame_rate="fast"),
    "not a number": lambda client: client.simulate(scene={"radius_m": float("nan")}),
    "not JSON": lambda client: client.simulate(scene={"radius_m": object()}),
    "a start of frames": lambda client: client.predict(FRAMES, start_s=1.0),
}


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_what_cannot_be_asked_is_not_sent(client, call):
    asked = []
    with pytest.raises(InvalidArgumentError) as caught:
        call(client(httpx2.MockTransport(asked.append)))
    assert asked == []
    assert caught.value.request_id is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"base_url": "localhost:8000"}, "base_url is 'localhost:8000', expected an address like"),
        ({"base_url": "http://[::1"}, "base_url"),
        ({"base_url": ""}, "base_url"),
        ({"api_key": "schl\u00fcssel"}, "api_key is not an API key"),
        ({"api_key": "two\r\nlines"}, "api_key is not an API key"),
        ({"timeout_s": 0}, "timeout_s is 0, expected seconds"),
        ({"timeout_s": "soon"}, "timeout_s"),
    ],
)
def test_wrong_arguments_of_a_client(arguments, message):
    for kind in (Client, AsyncClient):
        with pytest.raises(InvalidArgumentError, match=message) as caught:
            kind(**arguments)
        assert "schl" not in str(caught.value)


def test_an_address_is_shown_without_its_password():
    with (
        Client("http://user:secret@127.0.0.1:9", retries=0) as client,
        pytest.raises(UnreachableError, match=r"http://127\.0\.0\.1:9/models") as caught,
    ):
        client.models()
    assert "secret" not in str(caught.value)


# The environment.


def test_address_and_key_stand_in_the_environment(monkeypatch):
    seen = []

    def answer(request):
        seen.append((str(request.url.copy_with(path="/")), request.headers.get("authorization")))
        return httpx2.Response(200, json={"models": []})

    monkeypatch.setenv("ROLLCAST_URL", "http://robot:8000")
    monkeypatch.setenv("ROLLCAST_API_KEY", "standing")
    for arguments in ({}, {"base_url": "http://other", "api_key": "given"}, {"api_key": ""}):
        with Client(transport=httpx2.MockTransport(answer), **arguments) as client:
            client.models()
    assert seen == [
        ("http://robot:8000/", "Bearer standing"),
        ("http://other/", "Bearer given"),
        ("http://robot:8000/", None),
    ]
    monkeypatch.setenv("ROLLCAST_URL", "robot")
    with pytest.raises(InvalidArgumentError, match="ROLLCAST_URL is 'robot'"):
        Client()


@KINDS
def test_a_proxy_of_the_environment_is_named(monkeypatch, address, kind):
    port = address.rpartition(":")[2]
    monkeypatch.setenv("http_proxy", f"http://name:secret@127.0.0.1:{port}")
    monkeypatch.setenv("no_proxy", "direct.invalid")
    # The proxy gets the whole address as the path and gives up.
    with (
        kind("http://robot.invalid:8000", timeout_s=5, retries=0) as client,
        pytest.raises(ClientError) as caught,
    ):
        client.models()
    assert f"through the proxy http://127.0.0.1:{port} (http_proxy)" in str(caught.value)
    assert "secret" not in str(caught.value)
    with (
        kind("http://direct.invalid", timeout_s=5, retries=0) as client,
        pytest.raises(UnreachableError) as caught,
    ):
        client.models()
    assert "proxy" not in str(caught.value)


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("all_proxy", "socks5://127.0.0.1:9", r"the proxy socks5://127.0.0.1:9 \(all_proxy\)"),
        ("http_proxy", "ftp://127.0.0.1:9", r"the proxy ftp://127.0.0.1:9 \(http_proxy\)"),
        ("SSL_CERT_FILE", "/no/such/file", "SSL_CERT_FILE=/no/such/file"),
    ],
)
def test_an_environment_that_cannot_be_used_is_told(monkeypatch, variable, value, message):
    monkeypatch.delenv("no_proxy", raising=False)
    monkeypatch.setenv(variable, value)
    for kind in (Client, AsyncClient):
        with pytest.raises(InvalidArgumentError, match=message):
            kind("http://robot.invalid")


# Event loops.


@pytest.mark.filterwarnings("ignore:unclosed transport:ResourceWarning")
def test_an_awaited_client_serves_one_event_loop_after_the_other(address):
    client = AsyncClient(f"{address}/wrong-kind")

    async def ask():
        return (await client.health()).status

    async def ask_and_close():
        async with client:
            return await ask()

    assert [asyncio.run(ask()) for _ in range(2)] == ["ready"] * 2
    assert [asyncio.run(ask_and_close()) for _ in range(2)] == ["ready"] * 2
    gc.collect()  # what the first loops left open, while that warning is expected


# Answers that are spoiled at random.

NUMBERS = (0, -1, 1e308, 2**70, float("nan"), float("-inf"), 0.5)
VALUES = (None, True, "", "x" * 99, [], {}, [[]], [None], {"x": 1}, *NUMBERS)


def _valid(request):
    path = request.url.path
    kind = "text/event-stream" if path == STREAM else "application/json"
    return httpx2.Response(200, headers={"content-type": kind}, content=ANSWERS[path])


def _spoiled_value(value, rng):
    """Change one thing somewhere in a JSON value."""
    if isinstance(value, dict | list) and value and rng.random() < 0.9:
        copy = value.copy()
        key = rng.choice([*value]) if isinstance(value, dict) else rng.randrange(len(value))
        match rng.randrange(8):
            case 0:
                del copy[key]
            case 1 if isinstance(copy, list):
                copy.insert(key, copy[key])
            case 2 if isinstance(copy, list):
                rng.shuffle(copy)
            case _:
                copy[key] = _spoiled_value(value[key], rng)
        return copy
    return rng.choice(VALUES)


def _spoiled(path, rng):
    body = ANSWERS[path]
    if rng.random() < 0.2:  # bytes
        spoiled = bytearray(body)
        for _ in range(rng.randrange(1, 4)):
            spoiled[rng.randrange(len(spoiled))] = rng.randrange(256)
        return bytes(spoiled[: rng.randrange(len(spoiled))] if rng.random() < 0.3 else spoiled)
    if path != STREAM:
        return json.dumps(_spoiled_value(json.loads(body), rng)).encode()
    events = [event.split("\n") for event in body.decode().split("\n\n")[:-1]]
    index = rng.randrange(len(events))
    data = json.loads(events[index][1].removeprefix("data: "))
    events[index][1] = f"data: {json.dumps(_spoiled_value(data, rng))}"
    return "".join("\n".join(event) + "\n\n" for event in events).encode()


def _consistent(result):
    """Whether a result keeps what its class promises."""
    if isinstance(result, Forecast):
        balls, steps = result.positions.shape[:2]
        assert (balls, steps) == (2, HORIZON) == (len(result.colors), len(result.times_s))
        assert result.covariances.shape == (balls, steps, 2, 2)
        assert result.ellipse50_radii.shape == (steps,)
        turning = result.angular_velocities
        assert turning is None or turning.shape == (balls, steps, 3)
        assert np.isfinite(result.positions).all()
        assert np.isfinite(result.covariances).all()
        result.to_json()
    if isinstance(result, Simulation):
        balls, steps = result.positions.shape[:2]
        assert steps == 5 == len(result.frames) == len(result.times_s)
        assert result.frames.shape[1:] == (*result.frame_size[::-1], 3)
        assert result.angular_velocities.shape == (balls, steps, 3)
        assert result.surface.heights_m.shape == (len(result.surface.heights_m),) * 2
    return True


@pytest.mark.parametrize("path", CALLS)
def test_a_spoiled_answer_is_an_error_or_still_consistent(client, path):
    rng = random.Random(path)
    spoiled = []

    def answer(request):
        spoiled.append(_spoiled(path, rng))
        valid = _valid(request)
        return httpx2.Response(200, headers=valid.headers, content=spoiled[-1])

    connected = client(httpx2.MockTransport(answer))
    failed = 0
    for _ in range(300):
        try:
            assert _consistent(CALLS[path](connected)), spoiled[-1]
        except UnexpectedAnswerError:
            failed += 1
        except ClientError as error:
            pytest.fail(f"{error!r} for {spoiled[-1]!r}")
    assert failed > 30, "it is spoiled in earnest"


@pytest.mark.parametrize("addresses", [1, 5])
def test_the_timeout_bounds_connecting_to_all_addresses(monkeypatch, addresses):
    # Full backlogs: connecting to them takes for ever, as to machines that are switched off.
    with ExitStack() as opened:
        listener = opened.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        port = listener.getsockname()[1]
        for _ in range(3):
            filler = opened.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", port))
        found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))] * addresses
        other = [(*of[:4], (f"127.0.0.{index + 1}", port)) for index, of in enumerate(found)]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [found[0], *other[1:]])
        begun = time.monotonic()
        with (
            Client(f"http://many.test:{port}", timeout_s=1, retries=0) as client,
            pytest.raises(UnreachableError),
        ):
            client.health()
        assert time.monotonic() - begun < 4


def test_the_timeout_bounds_the_resolver(monkeypatch):
    released = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: released.wait(30) and [])
    begun = time.monotonic()
    with (
        Client("http://slow.test:8000", timeout_s=0.5, retries=0) as client,
        pytest.raises(RequestTimeoutError),
    ):
        client.health()
    released.set()
    assert time.monotonic() - begun < 10
