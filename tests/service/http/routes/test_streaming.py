"""Forecasts step by step, and forecasts that nobody waits for any more."""

import asyncio
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

from service.errors import DeadlineExceededError
from service.inference.deadlines import ClientGoneError, answered, streamed
from tests.service import samples
from tests.service.conftest import wait_until_ready
from tests.service.samples import body, moving_dot, parts


def events_of(text: str) -> list[tuple[str, dict]]:
    """Name and data of every server-sent event."""
    found = []
    for block in text.strip().split("\n\n"):
        lines = dict(line.split(": ", 1) for line in block.splitlines())
        found.append((lines["event"], json.loads(lines["data"])))
    return found


@pytest.mark.parametrize("objects", [1, 2])
def test_the_events_are_the_answer_of_predict_in_pieces(client, objects):
    whole = client.post("/predict", json=body(horizon=5, num_objects=objects)).json()
    response = client.post("/predict/stream", json=body(horizon=5, num_objects=objects))
    assert response.headers["content-type"].startswith("text/event-stream")
    *steps, (last, done) = events_of(response.text)
    assert [name for name, _ in steps] == ["step"] * 5
    assert last == "done"
    for index, (_, step) in enumerate(steps):
        assert (step["step"], step["time_s"]) == (index, whole["times_s"][index])
        assert step["ellipse50_radius"] == whole["ellipse50_radii"][index]
        for ball, expected in zip(step["objects"], whole["objects"], strict=True):
            assert ball == {
                "id": expected["id"],
                "position": expected["positions"][index],
                "covariance": expected["covariances"][index],
                "angular_velocity": expected["angular_velocities"][index],
            }
    for name in ("model", "frame_size", "frame_rate", "final_positions", "warnings"):
        assert done[name] == whole[name]
    assert [ball["color"] for ball in done["objects"]] == [b["color"] for b in whole["objects"]]


def test_multipart_streams_as_well(client):
    by_json = client.post("/predict/stream", json=body(horizon=3))
    by_parts = client.post("/predict/stream", files=parts(moving_dot()), data={"horizon": "3"})
    assert events_of(by_json.text)[:3] == events_of(by_parts.text)[:3]


def test_what_is_refused_before_the_first_step_has_its_status(client):
    refused = client.post("/predict/stream", json=body(horizon=0))
    assert (refused.status_code, refused.json()["field"]) == (422, "horizon")
    unknown = client.post("/predict/stream", json=body(model="nobody"))
    assert (unknown.status_code, unknown.json()["type"]) == (404, "/problems/unknown-model")


class Diverging(samples.DotPredictor):
    """Leaves every bound at step 3."""

    def step(self, state):
        step = super().step(state)
        if step.outputs["positions"][0, 0, 0] >= 52:
            step.outputs["positions"][:] = np.nan
        return step


def only(predictor: type[samples.DotPredictor]):
    """Load one model with this predictor."""
    model = samples.served()
    return lambda _: samples.Registry(
        [samples.Model("dot", 1, model.manifest, predictor(model.manifest))]
    )


def test_a_forecast_that_diverges_ends_with_an_error_event(start):
    client = start(only(Diverging))
    wait_until_ready(client)
    *steps, (last, problem) = events_of(client.post("/predict/stream", json=body(horizon=9)).text)
    assert [name for name, _ in steps] == ["step"] * 3
    assert last == "error"
    assert (problem["type"], problem["field"]) == ("/problems/forecast-diverged", "horizon")
    assert problem["expected"] == "at most 3 for these frames"
    assert client.post("/predict", json=body(horizon=3)).status_code == 200


class Failing(samples.DotPredictor):
    """Fails at step 3 for a reason that is no refusal."""

    failure: type[Exception] = RuntimeError

    def step(self, state):
        step = super().step(state)
        if step.outputs["positions"][0, 0, 0] >= 52:
            raise self.failure
        return step


@pytest.mark.parametrize("failure", [RuntimeError, ZeroDivisionError, MemoryError, KeyError])
def test_a_stream_that_fails_ends_with_an_error_event(start, caplog, monkeypatch, failure):
    monkeypatch.setattr(Failing, "failure", failure)
    client = start(only(Failing))
    wait_until_ready(client)
    *steps, (last, problem) = events_of(client.post("/predict/stream", json=body(horizon=9)).text)
    assert {name for name, _ in steps} == {"step"}
    assert len(steps) <= 3
    assert last == "error"
    assert problem["status"] in (500, 503)
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [failure]
    assert client.post("/predict/stream", json=body(horizon=3)).status_code == 200


class Slow(samples.DotPredictor):
    """Takes its time for every step, and counts them."""

    taken = 0

    def step(self, state):
        type(self).taken += 1
        time.sleep(0.02)
        return super().step(state)


@pytest.mark.parametrize("path", ["/predict", "/predict/stream"])
def test_a_deadline_frees_the_worker(start, path):
    client = start(only(Slow), inference_threads=1)
    wait_until_ready(client)
    Slow.taken = 0
    late = client.post(path, json=body(horizon=1000), headers={"X-Request-Timeout-Ms": "150"})
    if path == "/predict":
        assert late.status_code == 504
        problem = late.json()
    else:
        name, problem = events_of(late.text)[-1]
        assert name == "error"
    assert problem["type"] == "/problems/deadline-exceeded"
    # The only worker is free again, long before the rollout would have ended.
    assert client.post(path, json=body(horizon=2)).status_code == 200
    assert Slow.taken < 500


def test_the_settings_limit_what_a_client_may_ask_for(start):
    client = start(only(Slow), deadline_s=0.1)
    wait_until_ready(client)
    patient = {"X-Request-Timeout-Ms": "60000"}
    assert client.post("/predict", json=body(horizon=500), headers=patient).status_code == 504


@pytest.mark.parametrize("value", ["0", "-1", "soon", "1.5", "9" * 12, ""])
def test_a_timeout_that_is_no_number_is_refused(client, value):
    headers = {"X-Request-Timeout-Ms": value}
    refused = client.post("/predict", json=body(), headers=headers)
    assert refused.status_code == 422
    assert refused.json()["field"] == "x-request-timeout-ms"


class Leaving:
    """A request whose client goes away when told to."""

    def __init__(self) -> None:
        self.left = asyncio.Event()

    async def receive(self) -> dict[str, str]:
        await self.left.wait()
        return {"type": "http.disconnect"}


@pytest.fixture
def executor():
    with ThreadPoolExecutor(1) as executor:
        yield executor


def counting(steps: list[int], ended: threading.Event):
    """A call that hands steps over until nobody waits."""

    def call(token, emit=lambda _: None):
        try:
            for step in range(10_000):
                token.raise_if_cancelled()
                steps.append(step)
                emit(step)
                time.sleep(0.005)
        finally:
            ended.set()

    return call


def test_a_client_that_goes_away_frees_its_worker(executor):
    steps: list[int] = []
    ended = threading.Event()
    call = counting(steps, ended)

    async def scenario():
        request = Leaving()
        work = asyncio.ensure_future(
            answered(request, 30, lambda token: executor.submit(call, token))
        )
        while not steps:
            await asyncio.sleep(0.001)
        request.left.set()
        with pytest.raises(ClientGoneError):
            await work
        assert await asyncio.to_thread(ended.wait, 10)

    asyncio.run(scenario())
    assert len(steps) < 10_000


@pytest.mark.parametrize("by", ["leaving", "closing"])
def test_a_stream_that_nobody_reads_ends(executor, by):
    steps: list[int] = []
    ended = threading.Event()
    submit = partial(executor.submit, counting(steps, ended))

    async def scenario():
        request = Leaving()
        stream = streamed(request, 30, submit)
        assert await anext(stream) == 0
        if by == "leaving":
            request.left.set()
            rest = [step async for step in stream]
            assert len(rest) < 9_999
        else:
            await stream.aclose()
        assert await asyncio.to_thread(ended.wait, 10)

    asyncio.run(scenario())
    assert len(steps) < 10_000


def test_the_first_step_is_there_while_the_others_are_computed(executor):
    go_on = threading.Event()

    def call(token, emit):
        emit("first")
        assert go_on.wait(10)
        emit("second")

    async def scenario():
        stream = streamed(Leaving(), 30, partial(executor.submit, call))
        assert await anext(stream) == "first"
        go_on.set()
        return [event async for event in stream]

    assert asyncio.run(scenario()) == ["second"]


def test_a_stream_past_its_deadline_is_given_up(executor):
    ended = threading.Event()

    async def scenario():
        stream = streamed(Leaving(), 0.1, partial(executor.submit, counting([], ended)))
        with pytest.raises(DeadlineExceededError):
            async for _ in stream:
                pass
        assert await asyncio.to_thread(ended.wait, 10)

    asyncio.run(scenario())
