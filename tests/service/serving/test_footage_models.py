"""Models for footage of a set-up of one's own: chosen, answered and described."""

import pytest

from service.serving.registry import Registry
from tests.service.samples import body, served

COLORS = ["#ff8800", "#00ff00", "#0000ff", "#222222"]
RATE_HZ = 25.0
FOOTAGE = {
    "scenarios": ["footage"],
    "frame_rate_hz": RATE_HZ,
    "angular_velocity": False,
    "validation_error_px": 0.1,
}


def setup(name: str, balls: int):
    about = {"colors": COLORS[:balls], "crop": [125, 0, 478]}
    return served(name=name, objects=balls, setup=about, **FOOTAGE)


@pytest.fixture
def client(start):
    return start(lambda _: Registry([served(), setup("table", 1), setup("arena", 4)]))


def answer(client, **fields):
    response = client.post("/predict", json=body(horizon=6, **fields))
    assert response.status_code == 200, response.text
    return response.json()


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "dot"),
        ({"scenario": "footage"}, "table"),
        ({"num_objects": 4}, "arena"),
        ({"num_objects": 4, "scenario": "footage"}, "arena"),
        ({"model": "arena"}, "arena"),
        ({"model": "table", "scenario": "footage"}, "table"),
    ],
)
def test_a_rig_answers_for_footage_alone(client, fields, name):
    assert answer(client, **fields)["model"]["name"] == name


@pytest.mark.parametrize(
    ("fields", "field", "expected"),
    [
        ({"num_objects": 4, "scenario": "ellipsoid"}, "model", "none for num_objects 4"),
        ({"model": "arena", "scenario": "ellipsoid"}, "scenario", "footage, which arena@1"),
        ({"model": "dot", "scenario": "footage"}, "scenario", "hemisphere or ellipsoid"),
        ({"num_objects": 9}, "num_objects", "less than or equal to 8"),
    ],
)
def test_what_does_not_fit_is_refused(client, fields, field, expected):
    response = client.post("/predict", json=body(**fields))
    problem = response.json()
    assert response.status_code == 422
    assert problem["field"] == field
    assert expected in problem["expected"]


def test_steps_are_frames_of_the_camera_unless_the_request_says_otherwise(client):
    own = answer(client, model="arena")
    assert own["frame_rate"] == RATE_HZ
    assert own["times_s"] == pytest.approx([step / RATE_HZ for step in range(6)])
    assert not any("a second" in warning for warning in own["warnings"])
    other = answer(client, model="arena", frame_rate=50)
    assert other["frame_rate"] == 50
    assert any("trained on 25" in warning for warning in other["warnings"])


def test_balls_have_the_colors_of_their_clips(client):
    assert [ball["color"] for ball in answer(client, model="arena")["objects"]] == COLORS
    stream = client.post("/predict/stream", json=body(model="arena", horizon=2))
    assert all(f'"color":"{color}"' in stream.text for color in COLORS)


def test_the_list_tells_what_a_rig_sees(client):
    arena = client.get("/models/arena").json()
    assert arena["scenarios"] == ["footage"]
    assert arena["frame_rate_hz"] == RATE_HZ
    assert arena["setup"] == {"colors": COLORS, "crop": [125, 0, 478]}


@pytest.mark.parametrize(
    ("setup", "reason"),
    [
        (None, "setup belongs to footage"),
        ({"colors": COLORS[:3], "crop": [0, 0, 9]}, "setup has 3 colors for 4 objects"),
    ],
)
def test_a_manifest_tells_the_setup_of_footage(setup, reason):
    with pytest.raises(ValueError, match=reason):
        served(objects=4, setup=setup, **FOOTAGE)


def test_a_simulated_model_has_no_setup():
    with pytest.raises(ValueError, match="setup belongs to footage"):
        served(setup={"colors": COLORS[:1], "crop": [0, 0, 9]})
