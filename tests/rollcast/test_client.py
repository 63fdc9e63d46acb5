"""Both clients against a transport of its own; tests/e2e has them against the real service."""

import base64
import json
import time

import httpx2
import numpy as np
import pytest
from PIL import Image

from rollcast.client import Client
from rollcast.client.images import decoded, encoded
from rollcast.client.testing import FakeService
from rollcast.errors import (
    AuthError,
    BadRequestError,
    ClientError,
    OverloadedError,
    ServerError,
    UnexpectedAnswerError,
    UnreachableError,
)
from tests.rollcast.clients import PROBLEM, problem

FRAME = np.random.default_rng(0).integers(0, 256, (48, 48, 3), np.uint8)
FORECAST = {
    "model": {"name": "dot", "version": 1, "variant": "dotnet", "trained_horizon": 20},
    "frame_size": [48, 48],
    "frame_rate": 40,
    "step_rate": 40,
    "objects": [
        {
            "id": 0,
            "color": "red",
            "positions": [[1, 2], [3, 4]],
            "covariances": [[[1, 0], [0, 1]]] * 2,
            "covariance_source": "predicted",
            "angular_velocities": [[1, 2, 3]] * 2,
        },
        {
            "id": 1,
            "color": "green",
            "positions": [[5, 6], [7, 8]],
            "covariances": [[[1, 0], [0, 1]]] * 2,
            "covariance_source": "predicted",
            "angular_velocities": [[1, 2, 3]] * 2,
        },
    ],
    "times_s": [0, 0.025],
    "ellipse50_radii": [1.2, 0.9],
    "final_positions": None,
    "warnings": ["beware"],
    "timing_ms": {"decode": 1, "encode": 2, "rollout": 3, "total": 6},
}


class Service(httpx2.MockTransport):
    """Answers every request alike and keeps what was asked."""

    def __init__(self, answer, status=200, headers=None):
        super().__init__(self.respond)
        self.answer, self.status, self.headers = answer, status, headers
        self.request = None
        self.body = b""

    def respond(self, request):
        self.request = request
        self.body = request.content
        if isinstance(self.answer, Exception):
            raise self.answer
        content = self.answer if isinstance(self.answer, str) else json.dumps(self.answer)
        return httpx2.Response(self.status, content=content, headers=self.headers)


class Faltering(Service):
    """Fails some times before it answers."""

    def __init__(self, answer, failures):
        super().__init__(answer)
        self.failures = list(failures)
        self.ids = []

    def respond(self, request):
        self.ids.append(request.headers["x-request-id"])
        if not self.failures:
            return super().respond(request)
        failure = self.failures.pop(0)
        if isinstance(failure, Exception):
            raise failure
        return failure


def test_a_forecast_is_arrays(client):
    forecast = client(Service(FORECAST)).predict([FRAME] * 4, horizon=2, num_objects=2)
    assert forecast.positions.shape == (2, 2, 2)
    assert forecast.covariances.shape == (2, 2, 2, 2)
    assert forecast.angular_velocities is not None
    assert forecast.angular_velocities.shape == (2, 2, 3)
    assert forecast.final_positions is None
    np.testing.assert_array_equal(forecast.times_s, [0, 0.025])
    np.testing.assert_array_equal(forecast.ellipse50_radii, [1.2, 0.9])
    assert (forecast.colors, forecast.warnings) == (("red", "green"), ("beware",))
    assert (forecast.model.name, forecast.frame_size) == ("dot", (48, 48))
    assert forecast.timing_ms.total == 6


def test_frames_are_sent_in_order_as_parts_and_only_what_was_said(client):
    service = Service(FORECAST)
    frames = [np.full((32, 32, 3), value, np.uint8) for value in range(5)]
    client(service).predict(frames[:4], final_frame=frames[4], horizon=2)
    assert service.request.url.path == "/predict"
    places = [service.body.index(encoded(frame, None)) for frame in frames]
    assert places == sorted(places)
    assert service.body.count(b'name="frames"') == 4
    assert service.body.count(b' name="final_frame"') == 1
    assert b'name="horizon"\r\n\r\n2\r\n' in service.body
    assert b'name="model"\r\n\r\nauto\r\n' in service.body
    assert b"scenario" not in service.body


def test_frames_may_be_arrays_images_or_paths(tmp_path):
    path = tmp_path / "frame.png"
    Image.fromarray(FRAME).save(path)
    for frame in (FRAME, Image.fromarray(FRAME), path, str(path)):
        np.testing.assert_array_equal(decoded(encoded(frame, None)), FRAME)
    assert encoded(path, None) == path.read_bytes(), "a file is sent as it is"


def test_a_gap_in_the_names_of_frames_is_told(client, tmp_path):
    paths = [tmp_path / f"frame{number}.png" for number in (0, 1, 2, 5)]
    for path in paths:
        Image.fromarray(FRAME).save(path)
    told = [*client(Service(FORECAST)).predict(paths, horizon=2).warnings]
    said = "2 images are missing from the numbering, after frame2.png"
    assert told == [f"{said}: the frames are taken as evenly spaced", "beware"]


@pytest.mark.parametrize("shape", [(60, 40), (41, 60)])
def test_a_crop_is_the_largest_square_in_the_middle(shape, tmp_path):
    frame = np.random.default_rng(1).integers(0, 256, (*shape, 3), np.uint8)
    side = min(shape)
    top, left = (shape[0] - side) // 2, (shape[1] - side) // 2
    expected = frame[top : top + side, left : left + side]
    path = tmp_path / "frame.png"
    Image.fromarray(frame).save(path)
    for source in (frame, path):
        np.testing.assert_array_equal(decoded(encoded(source, "square")), expected)


@pytest.mark.parametrize(
    ("frame", "error", "message"),
    [
        (FRAME.astype(int), TypeError, r"int64, expected uint8 .* \.astype\(numpy\.uint8\)"),
        (FRAME.astype(float), ValueError, r"floats has values from .*, expected 0 to 1: divide"),
        (FRAME[..., :2], ValueError, r"shape \(48, 48, 2\), expected \[height, width\]"),
        ("no/such/file.png", OSError, "no/such"),
    ],
)
def test_what_is_no_frame_is_refused_here(frame, error, message):
    with pytest.raises(error, match=message):
        encoded(frame, None)


@pytest.mark.parametrize(
    "frames",
    [
        np.zeros((3, 48, 48), np.uint8),
        np.zeros((1, 48, 48), np.float32),
        np.zeros((48, 48, 3), np.uint8),
        np.zeros((48, 48), np.uint8),
    ],
    ids=lambda frames: str(frames.shape),
)
def test_one_picture_is_not_taken_for_frames(client, frames):
    with pytest.raises(TypeError, match=r"frames is one picture of the shape .*, expected a list"):
        client(Service(FORECAST)).predict(frames)
    with pytest.raises(TypeError, match="frames is one memoryview, expected a list of four"):
        client(Service(FORECAST)).predict(memoryview(frames.tobytes()))


def test_four_grey_pictures_in_one_array_are_frames(client):
    service = Service(FORECAST)
    client(service).predict(np.zeros((4, 48, 48), np.uint8), horizon=2)
    assert service.body.count(b'name="frames"') == 4


@pytest.mark.parametrize("how", ["predict", "stream", "many", "detect", "session"])
def test_frames_of_opencv_are_sent_as_rgb(client, how):
    service = FakeService()
    connected = client(service)
    red = np.zeros((48, 48, 3), np.uint8)
    red[..., 2] = 200  # the last channel of BGR
    frames = [red] * 4
    if how == "predict":
        connected.predict(frames, final_frame=red, channels="bgr", horizon=2)
    elif how == "stream":
        list(connected.predict_stream(frames, channels="bgr", horizon=2))
    elif how == "many":
        connected.predict_many([frames], channels="bgr", horizon=2)
    elif how == "detect":
        connected.detect(frames, channels="bgr")
    else:
        with connected.session(channels="bgr", horizon=2) as session:
            for frame in frames:
                session.send(frame)
                session.receive()
    asked = service.requests[-1]
    sent = [*asked.frames, *([asked.final_frame] if asked.final_frame else [])]
    assert len(sent) == (5 if how == "predict" else 4)
    for data in sent:
        assert decoded(data)[0, 0].tolist() == [200, 0, 0]


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (400, BadRequestError),
        (401, AuthError),
        (403, AuthError),
        (404, BadRequestError),
        (422, BadRequestError),
        (503, ServerError),
    ],
)
def test_a_problem_document_is_raised(client, status, kind):
    service = Service(PROBLEM | {"status": status}, status)
    with pytest.raises(kind) as caught:
        client(service).predict([FRAME] * 4)
    assert caught.value.problem.field == "horizon"
    assert str(caught.value) == f"A value is invalid ({status}): horizon: expected more"
    assert isinstance(caught.value, ClientError)


def test_a_key_goes_with_every_call():
    seen = []

    def answer(request):
        seen.append(request.headers.get("authorization"))
        return httpx2.Response(200, json={"models": []})

    for key in (None, "rollcast_secret"):
        with Client(transport=httpx2.MockTransport(answer), api_key=key) as client:
            client.models()
    assert seen == [None, "Bearer rollcast_secret"]


def test_a_full_queue_says_when_to_come_back(client):
    service = Service(PROBLEM | {"status": 429}, 429, {"retry-after": "3"})
    with pytest.raises(OverloadedError) as caught:
        client(service).models()
    assert caught.value.retry_after_s == 3


PASSING = {
    "no connection": lambda: httpx2.ConnectError("refused"),
    "connection lost": lambda: httpx2.RemoteProtocolError("the connection was lost"),
    "full": lambda: problem(429, {"retry-after": "0"}),
    "not ready": lambda: problem(503),
    "proxy is full": lambda: httpx2.Response(429, text="full"),
    "proxy lost the service": lambda: httpx2.Response(502, text="lost"),
}
LASTING = {
    "took too long": lambda: httpx2.ReadTimeout("slow"),
    "unknown": lambda: problem(404),
    "failed": lambda: problem(500),
    "gave up": lambda: problem(504),
    "another program": lambda: httpx2.Response(200, text="hello"),
}


@pytest.mark.parametrize("failure", PASSING.values(), ids=PASSING)
def test_what_may_pass_is_asked_again_under_the_same_id(client, failure):
    service = Faltering({"models": []}, [failure()])
    assert client(service, retries=1).models() == []
    assert len(service.ids) == 2
    assert len(set(service.ids)) == 1
    assert client(service).models() == []
    assert len(set(service.ids)) == 2, "another call has another id"


@pytest.mark.parametrize("failure", LASTING.values(), ids=LASTING)
def test_what_would_fail_again_is_raised_at_once(client, failure):
    service = Faltering({"models": []}, [failure()])
    with pytest.raises(ClientError):
        client(service, retries=2).models()
    assert len(service.ids) == 1


def test_a_client_gives_up(client):
    service = Faltering({"models": []}, [failure() for failure in PASSING.values()])
    with pytest.raises(OverloadedError):
        client(service, retries=2).models()
    assert service.request is None
    assert len(service.ids) == 3


def test_frames_are_sent_whole_again(client):
    service = Faltering(FORECAST, [httpx2.ConnectError("refused")])
    client(service, retries=1).predict([FRAME] * 4)
    assert service.body.count(encoded(FRAME, None)) == 4


@pytest.mark.parametrize("seconds", [0, 1])
def test_nobody_comes_back_before_the_service_asks_for_it(client, seconds):
    busy = problem(429, {"retry-after": str(seconds)})
    begun = time.monotonic()
    client(Faltering({"models": []}, [busy]), retries=1).models()
    assert time.monotonic() - begun >= seconds


@pytest.mark.parametrize("answer", ["<html>", "{}", '{"models": 1}'])
def test_another_program_at_the_address(client, answer):
    with pytest.raises(UnexpectedAnswerError, match=r"http://rollcast\.test/models answered 200"):
        client(Service(answer)).models()


@pytest.mark.parametrize("fault", [httpx2.ConnectError("refused"), httpx2.ReadTimeout("slow")])
def test_a_service_that_does_not_answer(client, fault):
    with pytest.raises(UnreachableError, match=r"http://rollcast\.test/health/ready"):
        client(Service(fault)).health()


def test_a_service_that_is_not_ready_is_no_error(client):
    assert client(Service({"status": "loading"}, 503)).health().status == "loading"


def test_models_and_their_cards(client):
    model = {"name": "a/b", "version": 1, "status": "ready"}
    assert client(Service({"models": [model]})).models()[0].version == 1
    service = Service(model | {"versions": [1, 2], "licence": "MIT", "card": "# A"})
    assert client(service).model("a/b", 1).card == "# A"
    assert service.request.url.raw_path == b"/models/a%2Fb/versions/1"


def test_a_simulation_is_arrays_and_its_scene_goes_back(client):
    scene = {
        "scenario": "hemisphere",
        "seed": 7,
        "textured": True,
        "radius_m": 0.1,
        "rotation_rad": 0.5,
        "axis_ratio": 1.0,
        "positions_m": [[0, 0, 0.1]],
        "velocities_m_s": [[1, 0, 0]],
        "orientations_xyzw": [[0, 0, 0, 1]],
    }

    file = base64.b64encode(encoded(FRAME, None)).decode()
    answer = {
        "scenario": "hemisphere",
        "seed": 7,
        "frame_rate": 40,
        "frame_size": [48, 48],
        "start_step": 80,
        "times_s": [0, 0.025, 0.05, 0.075],
        "frames": [file] * 4,
        "objects": [
            {
                "id": 0,
                "color": "red",
                "radius_px": 5,
                "positions": [[1, 2]] * 4,
                "angular_velocities": [[1, 2, 3]] * 4,
            }
        ],
        "scene": scene,
    }
    service = Service(answer)
    simulation = client(service).simulate("hemisphere", seed=7, steps=4)
    assert json.loads(service.body) == {
        "scenario": "hemisphere",
        "seed": 7,
        "steps": 4,
        "image_size": 128,
        "include_frames": True,
    }
    assert simulation.frames is not None
    np.testing.assert_array_equal(simulation.frames, FRAME[None].repeat(4, axis=0))
    assert simulation.positions.shape == (1, 4, 2)
    assert simulation.angular_velocities.shape == (1, 4, 3)
    client(service).simulate(scene=simulation.scene, steps=4)
    assert json.loads(service.body)["scene"] == json.loads(simulation.scene.model_dump_json())
