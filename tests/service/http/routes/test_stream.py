"""Sessions of the app with fake models: handshakes, first messages, ticks and windows."""

import json

import numpy as np
import pytest
from starlette.testclient import WebSocketDenialResponse, WebSocketDisconnect

from service.errors import QueueFullError
from tests.service.conftest import wait_until_ready
from tests.service.samples import body, dot, moving_dot, png


def opened(session, **options):
    session.send_text(json.dumps(options))
    answer = session.receive_json()
    assert (answer["tick"], answer["status"]) == (0, "open"), answer
    return session


def answers(session, frames):
    """Send frames one by one, each after the answer to the one before."""
    for frame in frames:
        session.send_bytes(frame)
        yield session.receive_json()


def statuses(session, frames):
    return [answer["status"] for answer in answers(session, frames)]


def test_every_tick_is_answered_and_forecasts_are_those_of_predict(client):
    frames = moving_dot(frames=7)
    with client.websocket_connect("/stream") as session:
        opened(session, model="dot", horizon=5)
        got = list(answers(session, frames))
    assert [answer["tick"] for answer in got] == [1, 2, 3, 4, 5, 6, 7]
    assert [answer["status"] for answer in got] == ["collecting"] * 3 + ["forecast"] * 4
    assert all(answer["latency_ms"] > 0 for answer in got)
    for first, answer in enumerate(got[3:]):
        asked = body(frames[first : first + 4], model="dot", horizon=5)
        expected = client.post("/predict", json=asked).json()
        expected.pop("timing_ms")
        answer["forecast"].pop("timing_ms")
        assert answer["forecast"] == expected


@pytest.mark.parametrize("side", [64, 200, 512])
def test_frames_of_any_size_are_decoded_as_by_predict(client, side):
    frames = moving_dot(side, 6)
    with client.websocket_connect("/stream") as session:
        opened(session, horizon=3)
        *_, last = answers(session, frames)
    expected = client.post("/predict", json=body(frames[2:], horizon=3)).json()
    assert last["forecast"]["objects"] == expected["objects"]
    assert last["forecast"]["frame_size"] == [side, side]


FIRST = {
    "no JSON": ("{", "malformed-body", None),
    "no object": ("[]", "invalid-value", "body"),
    "unknown": ('{"colour": 1}', "invalid-value", "colour"),
    "frames": ('{"frames": []}', "invalid-value", "frames"),
    "horizon": ('{"horizon": 0}', "invalid-value", "horizon"),
    "model": ('{"model": "nowhere"}', "unknown-model", "model"),
    "fifth frame": ('{"model": "between"}', "invalid-value", None),
    "too long": (json.dumps({"model": "x" * 70_000}), "body-too-large", "body"),
}


@pytest.mark.parametrize("case", FIRST)
def test_a_wrong_first_message_is_refused_and_the_session_closed(client, case):
    text, slug, field = FIRST[case]
    with client.websocket_connect("/stream") as session:
        session.send_text(text)
        answer = session.receive_json()
        with pytest.raises(WebSocketDisconnect) as closed:
            session.receive_json()
    assert (answer["tick"], answer["status"]) == (0, "refused")
    assert answer["problem"]["type"] == f"/problems/{slug}"
    if field is not None:
        assert answer["problem"]["field"] == field
    assert closed.value.code == 1008


def test_a_first_message_is_text(client):
    with client.websocket_connect("/stream") as session:
        session.send_bytes(b"{}")
        assert session.receive_json()["problem"]["type"] == "/problems/malformed-body"


def test_a_first_message_has_to_come_in_time(start):
    client = start(read_timeout_s=0.1)
    wait_until_ready(client)
    with client.websocket_connect("/stream") as session:
        assert session.receive_json()["problem"]["type"] == "/problems/body-too-slow"


def test_text_after_the_first_message_ends_the_session_after_its_answers(client):
    with client.websocket_connect("/stream") as session:
        opened(session)
        session.send_bytes(moving_dot()[0])
        session.send_text("{}")
        assert session.receive_json()["status"] == "collecting"
        with pytest.raises(WebSocketDisconnect) as closed:
            session.receive_json()
    assert closed.value.code == 1003


BROKEN = {
    "no image": (b"nonsense", "not-an-image"),
    "nothing": (b"", "not-an-image"),
    "cut off": (moving_dot()[0][:-30], "broken-image"),
    "too small": (png(dot(4, 4, 16)), "invalid-value"),
    "another size": (png(dot(40, 60, 64)), "invalid-value"),
}


@pytest.mark.parametrize("case", BROKEN)
@pytest.mark.parametrize("before", [1, 3, 5])
def test_a_refused_frame_restarts_the_window(client, case, before):
    data, slug = BROKEN[case]
    frames = moving_dot(frames=12)
    with client.websocket_connect("/stream") as session:
        opened(session, horizon=2)
        list(answers(session, frames[:before]))
        (refused,) = answers(session, [data])
        assert refused["status"] == "refused"
        assert refused["problem"]["type"] == f"/problems/{slug}"
        assert refused["problem"]["field"] == f"ticks[{before + 1}]"
        assert statuses(session, frames[:5]) == ["collecting"] * 3 + ["forecast"] * 2


def test_a_refused_first_frame_is_named_too(client):
    with client.websocket_connect("/stream") as session:
        opened(session)
        assert statuses(session, [b"x", *moving_dot()]) == [
            "refused", "collecting", "collecting", "collecting", "forecast",
        ]  # fmt: skip


def test_rectangles_are_refused_by_models_of_squares(client):
    picture = np.zeros((64, 96, 3), np.uint8)
    with client.websocket_connect("/stream") as session:
        opened(session, model="dot")
        *_, last = answers(session, [png(picture)] * 4)
    assert (last["status"], last["problem"]["value"]) == ("refused", "96 x 64")


def test_frames_of_one_session_are_limited(start):
    frame = moving_dot()[0]
    client = start(max_body_bytes=3 * len(frame) + len(frame) // 2)
    wait_until_ready(client)
    with client.websocket_connect("/stream") as session:
        opened(session)
        *three, fourth = answers(session, [frame] * 4)
    assert [answer["status"] for answer in three] == ["collecting"] * 3
    assert fourth["problem"]["type"] == "/problems/body-too-large"


def test_sessions_without_room_are_refused_and_release_their_bytes(start):
    frame = moving_dot()[0]
    client = start(max_total_body_bytes=2 * len(frame))
    wait_until_ready(client)
    for _ in range(3):
        with client.websocket_connect("/stream") as session:
            opened(session)
            *two, third = answers(session, [frame] * 3)
        assert [answer["status"] for answer in two] == ["collecting"] * 2
        assert third["problem"]["type"] == "/problems/too-many-bodies"
    assert client.app.state.service.bodies.size == 0


def test_a_request_takes_the_room_of_an_idle_session(start):
    frames = moving_dot()
    asked = body(frames, horizon=1)
    room = len(json.dumps(asked)) + 100
    client = start(max_total_body_bytes=room)
    wait_until_ready(client)
    with client.websocket_connect("/stream") as session:
        opened(session, horizon=1)
        list(answers(session, [frames[0]] * 3))
        client.app.state.service.bodies.resize(session_frames(client), room - 10)
        assert client.post("/predict", json=asked).status_code == 200
        assert statuses(session, frames) == ["collecting"] * 3 + ["forecast"]


def session_frames(client):
    """The bytes of the only session."""
    (held,) = client.app.state.service.bodies._held
    return held


def test_a_full_queue_refuses_a_tick_and_keeps_its_frame(client, monkeypatch):
    frames = moving_dot(frames=6)
    inference = client.app.state.service.inference
    submit = inference.submit

    def full(job, token):
        raise QueueFullError("all places are taken")

    with client.websocket_connect("/stream") as session:
        opened(session, horizon=2)
        list(answers(session, frames[:3]))
        inference.submit = full
        (refused,) = answers(session, [frames[3]])
        inference.submit = submit
        (last,) = answers(session, [frames[4]])
    assert refused["problem"]["type"] == "/problems/queue-full"
    expected = client.post("/predict", json=body(frames[1:5], horizon=2)).json()
    assert last["forecast"]["objects"] == expected["objects"]


def test_a_failure_of_the_service_refuses_a_tick(client, caplog):
    def failing(job, token):
        raise RuntimeError("the runtime broke")

    inference = client.app.state.service.inference
    submit = inference.submit
    with client.websocket_connect("/stream") as session:
        opened(session, horizon=2)
        inference.submit = failing
        (refused,) = answers(session, moving_dot()[:1])
        inference.submit = submit
        assert statuses(session, moving_dot())[-1] == "forecast"
    assert refused["problem"]["type"] == "/problems/internal-error"
    assert "the runtime broke" in caplog.text


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        (None, True),
        ("http://testserver", True),
        ("https://testserver", True),
        ("https://lab.example", True),
        ("https://evil.example", False),
        ("https://testserver.evil.example", False),
        ("http://lab.example", False),
        ("null", False),
    ],
)
def test_pages_of_other_origins_open_no_session(start, origin, allowed):
    client = start(allowed_origins=("https://lab.example",))
    wait_until_ready(client)
    headers = {} if origin is None else {"Origin": origin}
    if allowed:
        with client.websocket_connect("/stream", headers=headers) as session:
            opened(session)
        return
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        client.websocket_connect("/stream", headers=headers),
    ):
        pass
    assert denied.value.status_code == 403
    assert denied.value.json()["type"] == "/problems/origin-not-allowed"
    assert denied.value.headers["x-content-type-options"] == "nosniff"


def test_every_forecast_counts_in_the_rate_limit(start):
    client = start(requests_per_minute=4)
    wait_until_ready(client)
    with client.websocket_connect("/stream") as session:
        opened(session)
        assert statuses(session, moving_dot()) == ["collecting"] * 3 + ["refused"]
    with pytest.raises(WebSocketDenialResponse) as denied, client.websocket_connect("/stream"):
        pass
    assert denied.value.status_code == 429
    assert int(denied.value.headers["retry-after"]) >= 1


def test_deadlines_are_those_of_the_handshake(client):
    headers = {"X-Request-Timeout-Ms": "soon"}
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        client.websocket_connect("/stream", headers=headers),
    ):
        pass
    assert denied.value.json()["field"] == "x-request-timeout-ms"


def test_sessions_and_ticks_are_counted(client):
    def figure(name):
        lines = client.get("/metrics").text.splitlines()
        return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(name))

    with client.websocket_connect("/stream") as session:
        opened(session, horizon=1)
        statuses(session, [*moving_dot(), b"x"])
        assert figure("rollcast_sessions ") == 1
    assert figure("rollcast_sessions ") == 0
    for status, count in {"collecting": 3, "forecast": 1, "refused": 1}.items():
        assert figure(f'rollcast_session_ticks_total{{status="{status}"}}') == count
    handshake = 'http_requests_total{handler="/stream",method="GET",status="101"}'
    assert figure(handshake) == 1
