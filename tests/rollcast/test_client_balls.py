"""Points that say which balls are meant, and what comes back of each ball, with both clients."""

import json

import av
import numpy as np
import pytest

from rollcast.client import BallPrompt, Forecast
from rollcast.client.testing import FakeService
from rollcast.errors import BadRequestError, InvalidArgumentError
from rollcast.schemas import PredictResponse

WIDE = np.zeros((4, 48, 64, 3), np.uint8)
POINTS = [(40.0, 20.0), (10.0, 30.0)]


@pytest.fixture
def clip(tmp_path):
    path = tmp_path / "clip.mp4"
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=40)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index in range(20):
            grey = np.full((48, 64, 3), 40 + index, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("balls", "radii"),
    [
        (POINTS, [None, None]),
        ([(40, 20, 5), (10, 30)], [5, None]),
        ([BallPrompt(x=40, y=20), BallPrompt(x=10, y=30, radius=3)], [None, 3]),
        (np.array(POINTS), [None, None]),
        (np.array([(40, 20, 5), (10, 30, np.nan)], np.float32), [5, None]),
        ([np.array([40, 20]), [10, 30]], [None, None]),
    ],
)
def test_points_come_in_many_forms(client, balls, radii):
    service = FakeService()
    client(service).predict(WIDE, balls=balls, horizon=3)
    sent = json.loads(service.requests[-1].fields["balls"])
    assert [(ball["x"], ball["y"]) for ball in sent] == POINTS
    assert [ball["radius"] for ball in sent] == radii


@pytest.mark.parametrize(
    ("balls", "named"),
    [
        ((40, 20), r"one point .*expected a list"),
        ("40,20", "expected a list"),
        (BallPrompt(x=1, y=2), "expected a list"),
        ([(40,)], r"balls\[0\]"),
        ([(40, 20), (1, 2, 3, 4)], r"balls\[1\]"),
        ([(40, 20), "middle"], r"balls\[1\]"),
        ([(np.nan, 20)], r"balls\[0\].*finite"),
        ([(40, 20, 0)], r"balls\[0\].*greater than 0"),
        (np.zeros((2, 2, 2)), r"balls\[0\]"),
    ],
)
def test_what_is_no_point_is_named(client, balls, named):
    service = FakeService()
    with pytest.raises(InvalidArgumentError, match=named):
        client(service).predict(WIDE, balls=balls)
    assert service.requests == []


def test_a_forecast_tells_where_its_balls_were_seen_and_how_surely(client):
    forecast = client(FakeService()).predict(WIDE, balls=POINTS, horizon=3)
    assert forecast.frame_size == (64, 48)
    np.testing.assert_allclose(forecast.positions[:, 0], POINTS)
    assert forecast.seen.shape == (2, 4, 3)
    np.testing.assert_allclose(forecast.seen[:, -1, :2], POINTS)
    assert (forecast.scores > 0.5).all()
    assert forecast.object_warnings == ((), ())


def test_models_for_a_fixed_number_of_balls_tell_none_of_that(client):
    forecast = client(FakeService()).predict(np.zeros((4, 64, 64, 3), np.uint8), horizon=3)
    assert (forecast.scores, forecast.seen, forecast.object_warnings) == (None, None, ((),))
    assert "score" not in forecast.to_dataframe()


def test_streams_and_many_calls_take_points(client):
    service = FakeService()
    connected = client(service)
    stream = connected.predict_stream(WIDE, balls=POINTS, horizon=3)
    assert len(list(stream)) == 3
    assert stream.forecast.seen.shape == (2, 4, 3)
    assert len(connected.predict_many([WIDE, WIDE], balls=POINTS, horizon=3)) == 2
    assert all("balls" in asked.fields for asked in service.requests)


def test_score_and_place_are_in_every_form_of_the_result(client, tmp_path):
    forecast = client(FakeService()).predict(WIDE, balls=[(40, 20, 5)], horizon=3)
    rows = forecast.to_dataframe()
    assert rows["score"].tolist() == [forecast.scores[0]] * 3
    assert rows["radius_px"].tolist() == [5] * 3
    assert rows["warnings"].tolist() == [""] * 3
    (ball,) = json.loads(forecast.to_json())["objects"]
    assert ball["seen"][3] == {"x": 40, "y": 20, "radius": 5}
    assert ball["score"] == forecast.scores[0]
    forecast.save(tmp_path / "forecast.csv")
    assert "score" in (tmp_path / "forecast.csv").read_text().splitlines()[0]


def test_warnings_of_single_balls_are_kept(client):
    told = Forecast.from_response(_warned(client))
    assert told.object_warnings == (("Uncertain detection.",), ())
    assert told.to_dataframe()["warnings"].tolist()[:2] == ["Uncertain detection.", ""]


def test_a_kinematic_ball_has_no_angular_velocities_beside_one_that_has(client):
    answer = client(FakeService()).predict(WIDE, balls=POINTS, horizon=2)
    body = json.loads(answer.to_json())
    path = {"positions": [[1, 2], [3, 4]], "covariances": [[[1, 0], [0, 1]]] * 2}
    body["objects"][0] |= {
        "motion": "kinematic",
        "angular_velocities": None,
        "alternative": {"motion": "network"} | path,
    }
    told = Forecast.from_response(PredictResponse.model_validate(body))
    assert told.motions == ("kinematic", "network")
    assert np.isnan(told.angular_velocities[0]).all()
    assert not np.isnan(told.angular_velocities[1]).any()
    assert told.alternatives[0].positions == [(1, 2), (3, 4)]
    again = json.loads(told.to_json())["objects"]
    assert again[0]["angular_velocities"] is None
    assert again[0]["alternative"]["motion"] == "network"
    assert again[1]["angular_velocities"] is not None


def _warned(client):
    answer = client(FakeService()).predict(WIDE, balls=POINTS, horizon=2)
    body = json.loads(answer.to_json())
    body["objects"][0] |= {"score": 0.2, "warnings": ["Uncertain detection."]}
    return PredictResponse.model_validate(body)


def test_rings_are_drawn_where_balls_were_seen(client):
    forecast = client(FakeService()).predict(WIDE, balls=[(20, 20, 6)], horizon=3)
    picture = np.asarray(forecast.plot())
    assert picture.shape[:2] == (540, 720)
    scale = 720 / 64
    left = picture[int(20 * scale), int(14 * scale) - 3 : int(14 * scale) + 4].astype(int)
    assert (left.max(axis=0) - left.min(axis=0)).max() > 100, "an edge of the ring"


@pytest.mark.parametrize("ask", ["predict", "predict_stream"])
def test_a_refused_rectangle_says_what_helps(client, ask):
    connected = client(FakeService())

    def call():
        made = connected.predict(WIDE) if ask == "predict" else connected.predict_stream(WIDE)
        return list(made)

    with pytest.raises(BadRequestError, match=r'crop="square".*balls=') as caught:
        call()
    assert caught.value.problem.field == "frames[0]"
    assert 'crop="square"' in caught.value.advice


def test_other_refusals_have_no_such_advice(client):
    with pytest.raises(BadRequestError) as caught:
        client(FakeService()).predict(WIDE, balls=POINTS, num_objects=3)
    assert caught.value.advice == ""


def test_points_keep_a_video_whole(client, clip):
    service = FakeService()
    forecast = client(service).predict(clip, balls=[(60, 20)], horizon=3)
    assert forecast.frame_size == (64, 48)
    assert client(service).predict(clip, horizon=3).frame_size == (48, 48)


def test_points_of_a_video_follow_a_crop(client, clip):
    service = FakeService()
    forecast = client(service).predict(clip, balls=[(30, 20)], crop="square", horizon=3)
    assert forecast.frame_size == (48, 48)
    assert json.loads(service.requests[-1].fields["balls"])[0]["x"] == 30 - 8
