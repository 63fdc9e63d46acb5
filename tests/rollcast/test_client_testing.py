"""The fake service that users' own tests have."""

import asyncio
import doctest

import httpx2
import numpy as np
import pytest

import rollcast.client.testing
from rollcast.client import AsyncClient, Client
from rollcast.client.testing import FakeService
from rollcast.errors import (
    BadRequestError,
    InvalidArgumentError,
    OverloadedError,
    RequestTimeoutError,
)
from rollcast.scene import SCENARIOS
from rollcast.schemas import Problem
from tests.rollcast.clients import PROBLEM

FRAMES = np.zeros((4, 64, 64, 3), np.uint8)


def test_the_example_in_its_documentation():
    assert doctest.testmod(rollcast.client.testing).failed == 0


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("objects", [1, 2, 3])
def test_its_forecasts_go_on_where_its_scenes_show_the_balls(client, scenario, objects):
    connected = client(FakeService())
    scene = connected.simulate(scenario, seed=3, num_objects=objects, image_size=200, steps=30)
    forecast = connected.predict(scene.frames[:4], horizon=27, num_objects=objects)
    np.testing.assert_allclose(forecast.positions, scene.positions[:, 3:])
    for ball, channel in enumerate(range(objects)):
        column, row = scene.positions[ball, 20].astype(int)
        assert scene.frames[20, row, column, channel] > 100
    again = connected.simulate(scene=scene.scene, num_objects=objects, steps=4)
    assert again.scene == scene.scene
    assert connected.simulate(scenario, seed=3, include_frames=False).frames is None


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_its_scenes_have_a_ground_where_it_is_asked_for(client, scenario):
    connected = client(service := FakeService())
    assert connected.simulate(scenario, seed=3).surface is None
    assert "include_surface" not in service.requests[0].fields, "older services do not know it"
    scene = connected.simulate(scenario, seed=3, include_surface=True)
    heights = scene.surface.heights_m
    assert (heights.dtype, heights.shape) == (np.float64, (9, 9))
    outside = np.isnan(heights)
    bowl = scenario in ("hemisphere", "ellipsoid")
    assert outside[0, 0] == bowl
    assert not outside[4, 4]
    assert scene.surface.half_width_m == (1.05 if bowl else 1.25)


@pytest.mark.parametrize("path", [[[1, 2], [3, 4], [5, 6]], [[[1, 2], [3, 4], [5, 6]]]], ids=len)
def test_forecasts_may_be_chosen(client, path):
    connected = client(FakeService(path, variance_px2=9))
    forecast = connected.predict(FRAMES)
    assert forecast.positions.tolist() == [[[1, 2], [3, 4], [5, 6]]]
    assert forecast.covariances[0, 2].tolist() == [[9, 0], [0, 9]]
    assert connected.predict(FRAMES, horizon=2).positions.shape == (1, 2, 2)
    with pytest.raises(BadRequestError, match="at most 3"):
        connected.predict(FRAMES, horizon=4)
    with pytest.raises(BadRequestError, match="num_objects: expected 1"):
        connected.predict(FRAMES, num_objects=2)


def test_problems_may_be_chosen_and_pass(client):
    full = Problem.model_validate(PROBLEM | {"status": 429})
    service = FakeService(problem=full)
    connected = client(service)
    for ask in (connected.models, lambda: connected.predict(FRAMES)):
        with pytest.raises(OverloadedError) as caught:
            ask()
        assert caught.value.problem == full
    with pytest.raises(OverloadedError):
        list(connected.predict_stream(FRAMES))
    service.problem = None
    assert connected.predict(FRAMES).positions.shape == (1, 40, 2)


def test_it_keeps_what_it_was_asked(client):
    service = FakeService()
    connected = client(service)
    connected.predict(FRAMES, horizon=5, model="dot", final_frame=FRAMES[0])
    connected.simulate("hemisphere", seed=9)
    first, second = service.requests
    assert (first.method, first.path, first.fields["horizon"]) == ("POST", "/predict", "5")
    assert len(first.frames) == 4
    assert first.final_frame == first.frames[0]
    assert first.frames[0].startswith(b"\x89PNG")
    assert (second.path, second.fields["seed"]) == ("/simulate", 9)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda client: client.predict(FRAMES, horizon=0), "horizon"),
        (lambda client: client.predict(FRAMES[:3], final_frame=FRAMES[0]), "frames"),
        (lambda client: client.predict(FRAMES[:, 10:]), "square"),
        (lambda client: client.simulate("box", seed=1), "scenario"),
        (lambda client: client.simulate("hemisphere"), "seed"),
        (lambda client: client.model("nobody"), "404"),
    ],
    ids=["horizon", "three frames", "not square", "scenario", "no seed", "no model"],
)
def test_what_the_service_would_refuse_it_refuses(client, ask, message):
    with pytest.raises(BadRequestError, match=message):
        ask(client(FakeService()))


def test_its_model_can_be_looked_at(client):
    connected = client(FakeService())
    [entry] = connected.models()
    assert (entry.name, entry.status) == ("fake", "ready")
    assert connected.model("fake") == connected.model("fake", 1)
    assert connected.model("fake").versions == [1]
    assert connected.health().status == "ready"


def test_one_service_serves_several_clients():
    service = FakeService()
    for _ in range(2):
        with Client(transport=service) as connected:
            assert connected.models()


@pytest.mark.parametrize("path", [None, [[1, 2], [3, 4], [5, 6]]], ids=["lines", "chosen"])
def test_a_session_is_answered_at_once(path):
    service = FakeService(path)
    with Client(transport=service) as client:
        with client.session(horizon=3, frame_rate=30) as session:
            for tick in range(1, 7):
                assert session.send(FRAMES[0]) == tick
                answer = session.receive()
                assert (answer.tick, answer.status) == (tick, EXPECTED[tick - 1])
            expected = client.predict(FRAMES, horizon=3, frame_rate=30)
            np.testing.assert_array_equal(answer.forecast.positions, expected.positions)
            np.testing.assert_array_equal(answer.forecast.times_s, expected.times_s)
            assert session.newest() is None
            with pytest.raises(RequestTimeoutError):
                session.receive(timeout_s=60)
            service.problem = Problem.model_validate(PROBLEM)
            session.send(FRAMES[0])
            refused = session.receive()
            assert isinstance(refused.error, BadRequestError)
        with pytest.raises(BadRequestError), client.session():
            pass
    asked = service.requests[0]
    assert (asked.method, asked.path, len(asked.frames)) == ("GET", "/stream", 7)
    assert asked.fields == {"model": "auto", "horizon": 3, "frame_rate": 30.0}


EXPECTED = ["collecting"] * 3 + ["forecast"] * 3


def test_the_newest_answer_of_a_session_goes_before_older_ones():
    with Client(transport=FakeService()) as client, client.session() as session:
        for _ in range(2):
            session.send(FRAMES[0])
        assert session.newest().tick == 2
        for _ in range(4):
            session.send(FRAMES[0])
        assert (session.newest().tick, session.newest()) == (6, None)


def test_options_of_a_session_are_checked():
    client = Client(transport=FakeService())
    with client, pytest.raises(BadRequestError, match="horizon"), client.session(horizon=0):
        pass


def test_a_session_awaited():
    async def loop():
        client = AsyncClient(transport=FakeService())
        async with client, client.session(horizon=3) as session:
            for _ in range(4):
                await session.send(FRAMES[0])
            return await session.newest()

    assert asyncio.run(loop()).forecast.positions.shape == (1, 3, 2)


def test_other_transports_have_no_sessions():
    transport = httpx2.MockTransport(lambda _: httpx2.Response(200))
    with (
        Client(transport=transport) as client,
        pytest.raises(InvalidArgumentError, match="MockTransport opens no sessions"),
    ):
        client.session()
