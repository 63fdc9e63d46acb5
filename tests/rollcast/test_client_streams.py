"""Forecasts that arrive step by step, with both clients."""

import json

import httpx2
import numpy as np
import pytest

from rollcast.client.testing import FakeService
from rollcast.errors import (
    BadRequestError,
    OverloadedError,
    UnexpectedAnswerError,
    UnreachableError,
)
from tests.rollcast.clients import PROBLEM, Arriving, problem

FRAMES = np.zeros((4, 48, 48, 3), np.uint8)
STREAM = {"content-type": "text/event-stream; charset=utf-8"}


def event(name, **data):
    return f"event: {name}\ndata: {json.dumps(data)}\n\n".encode()


def step(index, turning=(0, 1, 2)):
    ball = {"id": 0, "position": [index, 2], "covariance": [[1, 0], [0, 1]]}
    return event(
        "step",
        step=index,
        time_s=index / 40,
        ellipse50_radius=1 - index / 10,
        objects=[ball | {"angular_velocity": turning}],
    )


DONE = event(
    "done",
    model={"name": "dot", "version": 1, "variant": "dotnet", "trained_horizon": 20},
    frame_size=[48, 48],
    frame_rate=40,
    step_rate=40,
    objects=[{"id": 0, "color": "red", "covariance_source": "predicted"}],
    final_positions=None,
    warnings=["beware"],
    timing_ms={"decode": 1, "encode": 2, "rollout": 3, "total": 6},
)


class Streaming(httpx2.MockTransport):
    """Answers with one body after another: parts of a stream, or whole answers."""

    def __init__(self, *answers):
        super().__init__(self.respond)
        self.answers = [Arriving(part) if isinstance(part, list) else part for part in answers]
        self.left = list(self.answers)

    def respond(self, request):
        answer = self.left.pop(0)
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, Arriving):
            return httpx2.Response(200, headers=STREAM, stream=answer)
        return answer


def test_steps_are_arrays_and_then_the_forecast_is_there(client):
    service = Streaming([step(0), step(1), DONE])
    with client(service).predict_stream(FRAMES, horizon=2) as stream:
        with pytest.raises(RuntimeError, match="after its last step has been read"):
            _ = stream.forecast
        steps = list(stream)
    assert [(arrived.step, arrived.time_s) for arrived in steps] == [(0, 0), (1, 1 / 40)]
    assert steps[1].positions.tolist() == [[1, 2]]
    assert steps[1].covariances.shape == (1, 2, 2)
    assert steps[1].angular_velocities.tolist() == [[0, 1, 2]]
    forecast = stream.forecast
    assert forecast.positions.tolist() == [[[0, 2], [1, 2]]]
    assert forecast.covariances.shape == (1, 2, 2, 2)
    assert forecast.angular_velocities.shape == (1, 2, 3)
    assert (forecast.colors, forecast.warnings) == (("red",), ("beware",))
    np.testing.assert_array_equal(forecast.times_s, [0, 1 / 40])
    np.testing.assert_array_equal(forecast.ellipse50_radii, [1, 0.9])
    assert list(stream) == [], "it has ended"


def test_what_the_model_has_not_is_none(client):
    stream = client(Streaming([step(0, None), DONE])).predict_stream(FRAMES)
    assert [arrived.angular_velocities for arrived in stream] == [None]
    assert stream.forecast.angular_velocities is None


@pytest.mark.parametrize("objects", [1, 2])
def test_the_streamed_forecast_is_that_of_predict(client, objects):
    connected = client(FakeService())
    whole = connected.predict(FRAMES, horizon=3, num_objects=objects)
    stream = connected.predict_stream(FRAMES, horizon=3, num_objects=objects)
    np.testing.assert_array_equal(
        np.stack([arrived.positions for arrived in stream], axis=1), whole.positions
    )
    for name in ("positions", "covariances", "ellipse50_radii", "angular_velocities", "times_s"):
        np.testing.assert_array_equal(getattr(stream.forecast, name), getattr(whole, name))
    assert stream.forecast.model == whole.model


def test_steps_come_before_the_rest_is_sent_and_leaving_early_closes_the_connection(client):
    service = Streaming([step(index) for index in range(1000)] + [DONE])
    with client(service).predict_stream(FRAMES) as stream:
        for arrived in stream:
            if arrived.step == 5:
                break
        assert service.answers[0].sent < 20
        assert not service.answers[0].closed
    assert service.answers[0].closed
    assert list(stream) == []
    with pytest.raises(RuntimeError):
        _ = stream.forecast


def test_a_stream_is_closed_at_its_end_and_by_hand(client):
    connected = client(service := Streaming([step(0), DONE], [step(0), step(1), DONE]))
    assert len(list(connected.predict_stream(FRAMES))) == 1
    assert service.answers[0].closed
    stream = connected.predict_stream(FRAMES)
    assert next(iter(stream)).step == 0
    stream.close()
    assert service.answers[1].closed


def test_nothing_is_sent_before_the_first_step_is_asked_for(client):
    service = Streaming([step(0), DONE])
    stream = client(service).predict_stream(FRAMES)
    assert len(service.left) == 1
    next(iter(stream))
    assert service.left == []
    stream.close()


def test_what_is_no_frame_is_told_by_the_first_step(client):
    with pytest.raises(TypeError, match="expected uint8"):
        list(client(Streaming()).predict_stream(FRAMES.astype(int)))


PASSING = {
    "full": lambda: problem(429),
    "not ready": lambda: problem(503),
    "no connection": lambda: httpx2.ConnectError("refused"),
    "lost before the first step": lambda: [httpx2.ReadError("lost")],
}


@pytest.mark.parametrize("failure", PASSING.values(), ids=PASSING)
def test_until_its_first_step_a_stream_is_asked_for_again(client, failure):
    service = Streaming(failure(), [step(0), DONE])
    assert len(list(client(service, retries=1).predict_stream(FRAMES))) == 1
    assert service.left == []


def test_after_its_first_step_it_is_not(client):
    service = Streaming([step(0), httpx2.ReadError("lost")], [step(0), DONE])
    stream = client(service, retries=1).predict_stream(FRAMES)
    assert next(iter(stream)).step == 0
    with pytest.raises(UnreachableError, match="lost"):
        list(stream)
    assert len(service.left) == 1
    assert service.answers[0].closed


def test_a_refusal_before_the_first_step_is_raised_as_by_predict(client):
    with pytest.raises(BadRequestError) as caught:
        list(client(Streaming(problem(422))).predict_stream(FRAMES))
    assert caught.value.problem.field == "horizon"
    busy = problem(429, {"retry-after": "3"})
    with (
        pytest.raises(OverloadedError) as full,
        client(Streaming(busy)).predict_stream(FRAMES),
    ):
        pass
    assert full.value.retry_after_s == 3


@pytest.mark.parametrize("steps", [0, 2])
def test_an_error_event_is_raised(client, steps):
    service = Streaming([step(index) for index in range(steps)] + [event("error", **PROBLEM)])
    arrived = []
    with pytest.raises(BadRequestError, match="expected more"):
        arrived.extend(client(service).predict_stream(FRAMES))
    assert service.answers[0].closed


BROKEN = {
    "no end": ([step(0)], "broke off after 1 steps"),
    "nothing": ([], "broke off after 0 steps"),
    "other bodies": ([event("step", step="one")], "not this API's"),
}


@pytest.mark.parametrize(("parts", "message"), BROKEN.values(), ids=BROKEN)
def test_a_stream_that_is_not_this_apis(client, parts, message):
    service = Streaming(parts)
    with pytest.raises(UnexpectedAnswerError, match=message):
        list(client(service).predict_stream(FRAMES))
    assert service.answers[0].closed


def test_another_program_at_the_address(client):
    with pytest.raises(UnexpectedAnswerError, match="answered 200"):
        list(client(Streaming(httpx2.Response(200, text="hello"))).predict_stream(FRAMES))


def test_events_of_a_newer_service_are_passed_over(client):
    parts = [b": a comment\n\n", event("news", of="later"), step(0), event("news"), DONE]
    # However the network cuts it.
    cut = b"".join(parts)
    whole = [cut[index : index + 7] for index in range(0, len(cut), 7)]
    for body in (parts, whole):
        stream = client(Streaming(body)).predict_stream(FRAMES)
        assert len(list(stream)) == 1
        assert stream.forecast.model.name == "dot"
