"""Models for any number of balls over HTTP: prompts, rectangles, balls in the answer."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from service.serving.registry import Registry
from tests.service.ball_samples import dots, files, served_balls
from tests.service.samples import body, parts, served

STEP = np.array([1.5, 1.0])


@pytest.fixture
def client(start):
    return start(lambda *_: Registry([served(), served(name="pair", objects=2), served_balls()]))


def paths(*last: tuple[float, float], step: np.ndarray = STEP) -> np.ndarray:
    """Paths that end somewhere, [balls, 4, 2]."""
    back = np.arange(-3, 1)[None, :, None] * step
    return np.array(last, float)[:, None] + back


def ask(client, seen: np.ndarray, size=(128, 128), **fields):
    response = client.post("/predict", json=body(files(dots(seen, *size)), **fields))
    assert response.status_code == 200, response.text
    return response.json()


def prompt(*points: tuple[float, float]) -> list[dict[str, float]]:
    return [{"x": x, "y": y} for x, y in points]


def test_prompts_choose_the_balls_their_order_and_the_model(client):
    seen = paths((40, 50), (90, 30), (70, 100))
    told = ask(client, seen, balls=prompt((91, 31), (41, 49)), horizon=5)
    assert told["model"]["name"] == "dots"
    first, second = told["objects"]
    assert np.allclose(first["positions"][0], [90, 30], atol=0.5)
    assert np.allclose(second["positions"][0], [40, 50], atol=0.5)
    assert np.allclose(second["positions"][4], np.array([40, 50]) + 4 * STEP, atol=2)
    path = [[place["x"], place["y"]] for place in second["seen"]]
    assert np.allclose(path, seen[0], atol=0.5)
    assert first["score"] > 0.9
    assert first["warnings"] == []
    assert int(first["color"][1:3], 16) > 100


@pytest.mark.parametrize("size", [(240, 320), (320, 240), (1000, 600)])
def test_answers_are_in_the_pixels_of_any_rectangle(client, size):
    height, width = size
    scale = max(size) / 128
    seen = paths((0.4 * width, 0.7 * height), step=scale * STEP)
    told = ask(client, seen, size, balls=prompt((0.4 * width + 2, 0.7 * height)), horizon=2)
    (ball,) = told["objects"]
    assert told["frame_size"] == [width, height]
    assert np.allclose(ball["positions"][0], seen[0, -1], atol=0.6 * scale)
    assert np.allclose(ball["covariances"][0], scale**2 * np.eye(2))
    assert np.allclose(ball["seen"][0]["x"], seen[0, 0, 0], atol=0.6 * scale)


def test_without_prompts_as_many_balls_as_move_are_followed(client):
    told = ask(client, paths((40, 50), (90, 30), (70, 100)), model="dots")
    assert len(told["objects"]) == 3
    assert len(ask(client, paths((40, 50), (90, 30)), model="dots", num_objects=1)["objects"]) == 1


def test_more_balls_than_other_models_follow_come_from_one_for_any_number(client):
    seen = paths(*((20 + 22 * k, 30 + 15 * (k % 3)) for k in range(5)))
    told = ask(client, seen, num_objects=5)
    assert told["model"]["name"] == "dots"
    assert ask(client, seen[:1])["model"]["name"] == "dot"


def test_a_prompt_on_nothing_is_answered_with_a_warning(client):
    (ball,) = ask(client, paths((40, 50)), balls=prompt((110, 110)))["objects"]
    assert ball["score"] < 0.5
    assert "Uncertain detection of a ball" in ball["warnings"][0]


def test_a_stream_closes_with_what_was_seen(client):
    request = body(files(dots(paths((40, 50)), 128, 128)), balls=prompt((40, 50)), horizon=3)
    response = client.post("/predict/stream", json=request)
    events = [line[6:] for line in response.text.splitlines() if line.startswith("data: ")]
    (ball,) = json.loads(events[-1])["objects"]
    assert ball["score"] > 0.9
    assert len(ball["seen"]) == 4


def test_prompts_come_as_json_in_a_form(client):
    images = files(dots(paths((40, 50), (90, 30)), 128, 128))
    form = {"balls": json.dumps(prompt((90, 30))), "horizon": "2"}
    response = client.post("/predict", files=parts(images), data=form)
    assert response.status_code == 200, response.text
    assert np.allclose(response.json()["objects"][0]["positions"][0], [90, 30], atol=0.5)


def test_requests_for_other_numbers_of_balls_do_not_mix(client):
    places = [(30 + 20 * k, 40 + 12 * (k % 3)) for k in range(4)]

    def one(number: int) -> None:
        chosen = places[: number % 4 + 1]
        told = ask(client, paths(*chosen), balls=prompt(*chosen), horizon=8)
        found = [ball["positions"][0] for ball in told["objects"]]
        assert np.allclose(found, chosen, atol=0.6)

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(one, range(24)))


@pytest.mark.parametrize(
    ("fields", "field", "expected"),
    [
        ({"balls": prompt((140, 3))}, "balls[0]", "a point of the frames of 128 x 128 pixels"),
        ({"balls": prompt((4, 3), (3, -1))}, "balls[1]", "a point of the frames"),
        ({"balls": []}, "balls", "1 items"),
        ({"balls": prompt(*[(9, 9)] * 9)}, "balls", "at most 8"),
        ({"balls": [{"x": 1, "y": 2, "radius": 0}]}, "balls.0.radius", "greater than 0"),
        ({"balls": "no"}, "balls", "JSON"),
        ({"balls": prompt((4, 3)), "num_objects": 2}, "num_objects", "1, the number of balls"),
        ({"balls": prompt((4, 3)), "model": "dot"}, "balls", "none: dot@1"),
        ({"model": "dots", "num_objects": 3}, "num_objects", "at most"),
        ({"model": "dot", "num_objects": 3}, "num_objects", "1, the number of balls of dot@1"),
        ({"num_objects": 9}, "num_objects", "less than or equal to 8"),
    ],
)
def test_what_does_not_fit_is_refused(client, fields, field, expected):
    images = files(dots(paths((40, 50)), 128, 128))
    response = client.post("/predict", json=body(images, **fields))
    problem = response.json()
    assert response.status_code == 422, problem
    assert problem["field"].startswith(field.split(".")[0].split("[")[0])
    assert expected in json.dumps(problem)


def test_rectangles_are_for_models_that_read_them(client):
    images = files(dots(paths((40, 50)), 100, 128))
    response = client.post("/predict", json=body(images, model="dot"))
    assert response.status_code == 422
    assert "square" in response.json()["detail"]


def test_both_motions_are_answered_and_auto_takes_kinematics_on_level_ground(start):
    kinematic = {"acceleration_ratio": 0.1, "level_slope": 0.01}
    client = start(lambda *_: Registry([served_balls(kinematic=kinematic)]))
    seen = paths((40, 50))
    fields = {"balls": prompt((40, 50)), "horizon": 6}
    (named,) = ask(client, seen, model="dots", **fields)["objects"]
    (chosen,) = ask(client, seen, **fields)["objects"]
    assert (named["motion"], named["alternative"]["motion"]) == ("network", "kinematic")
    assert (chosen["motion"], chosen["alternative"]["motion"]) == ("kinematic", "network")
    assert chosen["alternative"]["positions"] == named["positions"]
    assert chosen["alternative"]["covariances"] == named["covariances"]
    assert chosen["positions"] == named["alternative"]["positions"]
    assert chosen["angular_velocities"] is None
    expected = np.array([40, 50]) + np.arange(6)[:, None] * STEP
    assert np.allclose(chosen["positions"], expected, atol=2)
    spreads = np.array(chosen["covariances"])[:, 0, 0]
    assert (np.diff(spreads) > 0).all()
    stream = client.post("/predict/stream", json=body(files(dots(seen, 128, 128)), **fields)).text
    done = json.loads(stream.split("data: ")[-1])
    assert done["objects"][0]["motion"] == "kinematic"


def test_a_forecast_that_leaves_the_frame_says_when(client):
    told = ask(client, paths((120, 64), step=np.array([3.0, 0])), balls=prompt((120, 64)))
    (ball,) = told["objects"]
    positions = np.array(ball["positions"])
    first = int(np.argmax(positions[:, 0] > 128))
    assert 2 <= first <= 3
    assert f"leaves the frame at step {first}" in ball["warnings"][-1]
    assert positions.max() <= 141


def test_auto_sends_rectangles_to_the_model_that_reads_them(client):
    seen = paths((0.4 * 320, 0.7 * 240), step=2.5 * STEP)
    told = ask(client, seen, (240, 320), horizon=2)
    assert told["model"]["name"] == "dots"
    assert told["frame_size"] == [320, 240]


def test_auto_takes_scenarios_that_no_other_model_knows(start):
    bowls = served(name="pair", objects=2, scenarios=["ellipsoid"])
    made = start(lambda *_: Registry([served(), bowls, served_balls()]))
    images = files(dots(paths((40, 50), (90, 30)), 128, 128))
    for scenario, name in (("ellipsoid", "pair"), ("hemisphere", "dots")):
        response = made.post("/predict", json=body(images, num_objects=2, scenario=scenario))
        assert response.status_code == 200, response.text
        assert response.json()["model"]["name"] == name


def test_prompts_without_a_model_for_any_number_are_refused(start):
    alone = start(lambda *_: Registry([served()]))
    images = files(dots(paths((40, 50)), 128, 128))
    response = alone.post("/predict", json=body(images, balls=prompt((40, 50))))
    assert response.status_code == 422, response.text
    assert response.json()["field"] == "model"


def test_models_tell_how_many_balls_they_follow(client):
    entries = {entry["name"]: entry for entry in client.get("/models").json()["models"]}
    assert entries["dots"]["max_objects"] == 8
    assert entries["dot"]["max_objects"] is None


def test_the_former_name_of_the_number_is_read(client):
    seen = paths((40, 50), (90, 30))
    images = files(dots(seen, 128, 128))
    asked = body(images, model="dots", objects=2)
    assert len(client.post("/predict", json=asked).json()["objects"]) == 2
    form = {"model": "dots", "objects": "2"}
    assert len(client.post("/predict", data=form, files=parts(images)).json()["objects"]) == 2
    both = client.post("/predict", json={**asked, "num_objects": 2})
    assert both.status_code == 422
    assert "objects" in both.json()["detail"]


@pytest.fixture
def at_any_rate(start):
    knows = served_balls(frame_rates_hz=[15, 125], trained_horizon=40)
    return start(lambda *_: Registry([served(), knows]))


@pytest.mark.parametrize("rate", [15, 24, 30, 60, 120])
def test_balls_go_on_by_as_much_a_frame_at_every_rate(at_any_rate, rate):
    told = ask(at_any_rate, paths((40, 50)), frame_rate=rate, horizon=9)
    assert told["model"]["name"] == "dots", "the model that is told the rate"
    assert told["warnings"] == []
    assert told["times_s"] == pytest.approx(np.arange(9) / rate)
    (ball,) = told["objects"]
    expected = np.array([40, 50]) + np.arange(9)[:, None] * STEP
    assert np.allclose(ball["positions"], expected, atol=1.5)
    ways = np.diff(ball["positions"], axis=0)
    assert np.allclose(ways, ways[0], atol=1e-3)
    assert np.allclose(ball["alternative"]["positions"], expected, atol=1.5)


def test_a_stream_has_the_steps_of_the_whole_answer_at_every_rate(at_any_rate):
    images = files(dots(paths((40, 50)), 128, 128))
    for rate in (24, 90):
        fields = {"frame_rate": rate, "horizon": 7, "model": "dots"}
        whole = at_any_rate.post("/predict", json=body(images, **fields)).json()
        streamed = at_any_rate.post("/predict/stream", json=body(images, **fields))
        steps = [
            json.loads(line[5:])
            for line in streamed.text.splitlines()
            if line.startswith("data:") and "time_s" in line
        ]
        assert [step["step"] for step in steps] == list(range(7))
        assert [step["time_s"] for step in steps] == whole["times_s"]
        (ball,) = whole["objects"]
        assert [step["objects"][0]["position"] for step in steps] == ball["positions"]


def test_rates_that_the_model_was_not_taught_are_named(at_any_rate):
    told = ask(at_any_rate, paths((40, 50)), model="dots", frame_rate=5, horizon=2)
    (warning,) = told["warnings"]
    assert "5 a second" in warning
    assert "15 to 125" in warning


def test_kinematic_forecasts_have_the_steps_that_are_asked(at_any_rate):
    fields = {"model": "dots", "frame_rate": 30}
    usual = ask(at_any_rate, paths((40, 50)), horizon=5, **fields)["objects"][0]
    finer = ask(at_any_rate, paths((40, 50)), horizon=9, step_rate=60, **fields)["objects"][0]
    assert np.allclose(finer["positions"][::2], usual["positions"], atol=1e-3)
    other, finer_other = (ball["alternative"]["positions"] for ball in (usual, finer))
    assert np.allclose(finer_other[::2], other, atol=1e-3)
    assert np.allclose(finer_other[1::2], np.array(other[1:]) - STEP / 2, atol=0.1)
