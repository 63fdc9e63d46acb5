"""Sessions with a real server: both clients, newest frames, keys, disconnects and stops."""

import asyncio
import signal
import subprocess
import threading
import time

import httpx2
import numpy as np
import pytest

from rollcast.client import AsyncClient, Client
from rollcast.errors import (
    AuthError,
    BadRequestError,
    InvalidArgumentError,
    RequestTimeoutError,
    ServerError,
    UnreachableError,
)
from tests.e2e.conftest import (
    LONGEST_HORIZON,
    ROOT,
    SERVICE_PYTHON,
    held,
    start_service,
    stop_service,
    wait_until_ready,
)
from tests.e2e.workers import Service, wait_for

LONG = {"model": "dispnet", "horizon": LONGEST_HORIZON}
"""A forecast that takes far longer than a few frames."""


@pytest.fixture(scope="module")
def frames(address):
    with Client(address) as client:
        found = client.simulate("hemisphere", seed=7, steps=30).frames
    assert found is not None
    return found


@pytest.fixture(scope="module")
def rectangles(frames):
    """Frames of 160 x 120 pixels."""
    return np.pad(frames[:, 4:124], ((0, 0), (0, 0), (16, 16), (0, 0)), mode="edge")


def figure(address, name):
    """The value of a metric."""
    lines = httpx2.get(f"{address}/metrics").text.splitlines()
    return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(name))


def fill(session, frames):
    """Send the first three frames and read their answers."""
    for frame in frames[:3]:
        session.send(frame)
        assert session.receive().status == "collecting"


def assert_equal(forecast, expected):
    assert forecast.model == expected.model
    assert forecast.warnings == expected.warnings
    assert forecast.outputs.keys() == expected.outputs.keys()
    for name, values in expected.outputs.items():
        np.testing.assert_array_equal(forecast.outputs[name], values)


@pytest.mark.parametrize("options", [{"model": "fieldnet"}, {"model": "posnet"}, {}], ids=str)
def test_forecasts_are_those_of_predict_to_the_bit(client, frames, options):
    with client.session(horizon=20, **options) as session:
        for tick, frame in enumerate(frames[:8], start=1):
            assert session.send(frame) == tick
            answer = session.receive()
            assert answer.tick == tick
            assert answer.latency_ms > 0
            assert answer.error is None
            if tick < 4:
                assert answer.status == "collecting"
                assert answer.forecast is None
                continue
            assert answer.status == "forecast"
            expected = client.predict(frames[tick - 4 : tick], horizon=20, **options)
            assert_equal(answer.forecast, expected)


def test_rectangles_are_forecast_as_by_predict(client, rectangles):
    with client.session(horizon=5, model="any-ball") as session:
        fill(session, rectangles)
        for tick in range(4, 7):
            session.send(rectangles[tick - 1])
            expected = client.predict(rectangles[tick - 4 : tick], horizon=5, model="any-ball")
            assert_equal(session.receive().forecast, expected)


def test_frames_are_cropped_by_the_client(client, rectangles):
    with client.session(horizon=5, model="fieldnet", crop="square") as session:
        fill(session, rectangles)
        session.send(rectangles[3])
        expected = client.predict(rectangles[:4], horizon=5, model="fieldnet", crop="square")
        assert_equal(session.receive().forecast, expected)


def test_the_newest_frame_wins_and_every_tick_is_answered_in_order(client, frames):
    with client.session(**LONG) as session:
        for frame in frames:
            session.send(frame)
        answers = [session.receive() for _ in frames]
        with pytest.raises(RequestTimeoutError):
            session.receive(timeout_s=0.05)
    assert [answer.tick for answer in answers] == list(range(1, len(frames) + 1))
    statuses = [answer.status for answer in answers]
    assert statuses[:3] == ["collecting"] * 3
    assert {*statuses[3:]} == {"forecast", "superseded"}
    assert statuses.count("forecast") < len(frames) / 2
    assert statuses[-1] == "forecast"
    expected = client.predict(frames[-4:], **LONG)
    assert_equal(answers[-1].forecast, expected)


def test_the_newest_forecast_is_read_without_waiting(client, frames):
    with client.session(horizon=20, model="fieldnet") as session:
        assert session.newest() is None
        for frame in frames:
            session.send(frame)
        found = []
        deadline = time.monotonic() + 30
        while not found or found[-1].tick < len(frames):
            assert time.monotonic() < deadline
            if (answer := session.newest()) is not None:
                found.append(answer)
            time.sleep(0.005)
    assert found[-1].status == "forecast"
    assert [answer.tick for answer in found] == sorted({answer.tick for answer in found})


def test_the_awaited_client_has_sessions_too(address, client, frames):
    async def loop():
        answers, newest = [], []
        async with (
            AsyncClient(address) as awaited,
            awaited.session(horizon=20, model="fieldnet") as session,
        ):
            for frame in frames[:8]:
                await session.send(frame)
                answers.append(await session.receive())
            assert await session.newest() is None
            for frame in frames[8:16]:
                await session.send(frame)
            deadline = time.monotonic() + 30
            while not newest or newest[-1].tick < 16:
                assert time.monotonic() < deadline
                if (answer := await session.newest()) is not None:
                    newest.append(answer)
                await asyncio.sleep(0.005)
            with pytest.raises(RequestTimeoutError):
                await session.receive(timeout_s=0.05)
        return answers, newest

    answers, newest = asyncio.run(loop())
    assert [answer.status for answer in answers] == ["collecting"] * 3 + ["forecast"] * 5
    expected = client.predict(frames[4:8], horizon=20, model="fieldnet")
    assert_equal(answers[-1].forecast, expected)
    assert newest[-1].status == "forecast"


def test_a_refused_frame_is_an_answer_and_the_session_goes_on(client, frames):
    with client.session(horizon=5, model="fieldnet") as session:
        fill(session, frames)
        session.send(b"\x89PNG\r\n\x1a\nrubbish")
        refused = session.receive()
        assert (refused.tick, refused.status) == (4, "refused")
        assert isinstance(refused.error, BadRequestError)
        assert refused.error.problem.field == "ticks[4]"
        assert refused.error.request_id is not None
        fill(session, frames)
        session.send(frames[3])
        assert session.receive().status == "forecast"


def test_a_frame_that_cannot_be_read_is_not_sent(client, frames):
    with client.session(model="fieldnet") as session:
        with pytest.raises(ValueError, match="is not an image"):
            session.send(b"rubbish")
        assert session.send(frames[0]) == 1


@pytest.mark.parametrize(
    ("options", "field"),
    [({"model": "nowhere"}, "model"), ({"horizon": 0}, "horizon"), ({"scenario": "x"}, "scenario")],
)
def test_wrong_options_are_refused_when_the_session_is_opened(client, options, field):
    with pytest.raises(BadRequestError) as refused, client.session(**options):
        pass
    assert refused.value.problem.field == field


def test_arguments_that_cannot_be_sent_are_refused_before(client):
    with pytest.raises(InvalidArgumentError, match="horizon"):
        client.session(horizon=1.5)
    with pytest.raises(RuntimeError, match="context manager"):
        client.session().receive()


def test_no_service_is_no_session():
    with (
        Client("http://127.0.0.1:9", retries=0) as client,
        pytest.raises(UnreachableError, match="does not answer") as refused,
        client.session(),
    ):
        pass
    assert refused.value.request_id is not None


def test_a_client_that_goes_away_leaves_no_work_behind(address, frames):
    for _ in range(5):
        with Client(address) as client, client.session(**LONG) as session:
            fill(session, frames)
            session.send(frames[3])
            wait_for(lambda: held(address) > 0, 10)
        wait_for(lambda: held(address) == 0, 2)
    wait_for(lambda: figure(address, "rollcast_sessions ") == 0, 2)


def test_keys_are_asked_for_and_those_removed_no_longer_forecast(tmp_path, frames):
    file = tmp_path / "keys.json"

    def keys(*arguments):
        command = [SERVICE_PYTHON, "-m", "service.auth", "--file", file, *arguments]
        made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        return made.stdout.strip()

    token = keys("add", "robot")
    measuring = keys("add", "gauge", "--scope", "metrics")
    process, address = start_service(ROLLCAST_KEYS_FILE=str(file))
    try:
        for key in ("", "wrong", measuring):
            with (
                Client(address, api_key=key) as client,
                pytest.raises(AuthError) as refused,
                client.session(),
            ):
                pass
            assert refused.value.status_code == (403 if key == measuring else 401)
        with Client(address, api_key=token) as client:
            wait_until_ready(client)
            with client.session(horizon=3, model="fieldnet") as session:
                fill(session, frames)
                session.send(frames[3])
                assert session.receive().status == "forecast"
                keys("remove", "robot")
                deadline = time.monotonic() + 10
                while (answer := next_answer(session, frames[4])).status == "forecast":
                    assert time.monotonic() < deadline
                    time.sleep(0.1)
                assert isinstance(answer.error, AuthError)
    finally:
        stop_service(process)


def next_answer(session, frame):
    session.send(frame)
    return session.receive()


def test_a_stopping_service_sends_what_it_computes_and_ends_its_sessions(frames):
    process, address = start_service(ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S="60")
    with Client(address) as client:
        wait_until_ready(client)
        with client.session(**LONG) as working, client.session(model="fieldnet") as idle:
            fill(working, frames)
            working.send(frames[3])
            wait_for(lambda: held(address) > 0, 10)
            process.send_signal(signal.SIGTERM)
            answer = working.receive()
            assert (answer.tick, answer.status) == (4, "forecast")
            for session in (working, idle):
                with pytest.raises(UnreachableError, match="1012"):
                    session.receive(timeout_s=10)
    begun = time.monotonic()
    process.communicate(timeout=30)
    assert time.monotonic() - begun < 20
    assert process.returncode in {0, -signal.SIGTERM}


def test_a_loading_or_draining_service_opens_no_session(frames):
    process, address = start_service(ROLLCAST_SHUTDOWN_DELAY_S="2")
    with Client(address, retries=0) as client:
        wait_until_ready(client)
        process.send_signal(signal.SIGTERM)
        wait_for(lambda: client.health().status == "draining", 10)
        with pytest.raises(ServerError) as refused, client.session():
            pass
    assert refused.value.problem.type == "/problems/not-ready"
    assert refused.value.retry_after_s > 0
    stop_service(process)


def test_every_worker_process_has_sessions(frames):
    with Service(2, only="fieldnet") as service, Client(service.address) as client:
        answers = []
        for _ in range(6):
            with client.session(model="fieldnet", horizon=3) as session:
                fill(session, frames)
                answers.append(next_answer(session, frames[3]))
        expected = client.predict(frames[:4], model="fieldnet", horizon=3)
        for answer in answers:
            assert_equal(answer.forecast, expected)
        with client.session(model="fieldnet") as session:
            assert service.metric("rollcast_sessions") == [1.0]
            service.popen.terminate()
            with pytest.raises(UnreachableError, match="1012"):
                session.receive(timeout_s=10)
            service.popen.communicate(timeout=30)


def test_two_threads_may_send_and_receive(client, frames):
    answers = []
    with client.session(horizon=3, model="fieldnet") as session:

        def read():
            answers.extend(session.receive() for _ in frames)

        reader = threading.Thread(target=read)
        reader.start()
        for frame in frames:
            session.send(frame)
        reader.join(30)
    assert [answer.tick for answer in answers] == list(range(1, len(frames) + 1))
