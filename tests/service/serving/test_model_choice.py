"""Which model answers."""

import pytest

from service.serving.registry import Model, Registry
from tests.service.ball_samples import served_balls
from tests.service.samples import body, moving_dot, parts, served


def answered_by(client, **fields):
    response = client.post("/predict", json=body(horizon=1, **fields))
    assert response.status_code == 200, response.text
    model = response.json()["model"]
    return f"{model['name']}@{model['version']}"


def refusal(client, **fields):
    response = client.post("/predict", json=body(**fields))
    return response.status_code, response.json()


@pytest.mark.parametrize(
    ("fields", "label"),
    [
        ({}, "dot@1"),
        ({"model": "auto"}, "dot@1"),
        ({"scenario": "hemisphere"}, "bowl@1"),
        ({"scenario": "ellipsoid"}, "dot@1"),
        ({"num_objects": 2}, "pair@1"),
        ({"model": "dot"}, "dot@1"),
        ({"model": "dot@2"}, "dot@2"),
        ({"model": "line"}, "line@1"),
        ({"model": "pair"}, "pair@1"),
        ({"model": "bowl", "scenario": "hemisphere"}, "bowl@1"),
    ],
)
def test_the_model_that_answers(client, fields, label):
    assert answered_by(client, **fields) == label


@pytest.mark.parametrize(
    "name", ["nope", "dot@3", "dot@x", "dot@", "", "dot@1@1", "../dot", "dot@²"]
)
def test_an_unknown_model_is_named_with_those_that_exist(client, name):
    status, problem = refusal(client, model=name)
    assert status == 404
    assert problem["type"] == "/problems/unknown-model"
    assert (problem["field"], problem["value"]) == ("model", name)
    assert problem["expected"]


def test_a_refused_model_says_why(client):
    status, problem = refusal(client, model="broken@1")
    assert status == 503
    assert problem["type"] == "/problems/model-unavailable"
    assert problem["detail"] == "broken@1 is invalid: manifest.json is missing"


@pytest.mark.parametrize(
    ("fields", "field", "expected"),
    [
        ({"model": "dot", "num_objects": 2}, "num_objects", "1, the number of balls of dot@1"),
        (
            {"model": "bowl", "scenario": "ellipsoid"},
            "scenario",
            "hemisphere, which bowl@1 is made for",
        ),
        ({"model": "between"}, "final_frame", "an image of step 9, which between@1 needs"),
    ],
)
def test_a_named_model_that_does_not_fit(client, fields, field, expected):
    status, problem = refusal(client, **fields)
    assert status == 422
    assert problem["type"] == "/problems/invalid-value"
    assert (problem["field"], problem["expected"]) == (field, expected)


def test_auto_without_a_suitable_model(client):
    status, problem = refusal(client, num_objects=3)
    assert status == 422
    assert problem["type"] == "/problems/no-suitable-model"
    assert "dot@1" in problem["expected"]


@pytest.mark.parametrize(
    ("fields", "field", "expected"),
    [
        ({"horizon": "40"}, "horizon", "10: the final frame of between@1 shows step 9"),
        ({"model": "dot"}, "final_frame", "none: dot@1 reads the observed frames alone"),
    ],
)
def test_a_final_frame_accepts_only_what_its_model_is_made_for(client, fields, field, expected):
    images = moving_dot(frames=5)
    files = [*parts(images[:4]), ("final_frame", ("f.png", images[4]))]
    response = client.post("/predict", files=files, data=fields)
    assert response.status_code == 422
    assert (response.json()["field"], response.json()["expected"]) == (field, expected)


def test_the_horizon_that_a_final_frame_fixes_may_be_said(client):
    images = moving_dot(frames=5)
    files = [*parts(images[:4]), ("final_frame", ("f.png", images[4]))]
    fields = {"horizon": "10"}
    assert client.post("/predict", files=files, data=fields).status_code == 200


def test_auto_compares_errors_at_the_horizon_of_the_request(start):
    def described(name: str, *errors: tuple[int, float]) -> Model:
        rows = [
            {
                "split": "validation", "scenario": "hemisphere", "horizon": horizon,
                "sequences": 9, "position_error_px": error,
            }
            for horizon, error in errors
        ]  # fmt: skip
        return served(name=name, metrics=rows, validation_error_px=errors[0][1])

    models = [described("near", (10, 1.0), (40, 9.0)), described("far", (10, 2.0), (40, 3.0))]
    client = start(lambda *_: Registry(models))
    chosen = {
        horizon: client.post("/predict", json=body(horizon=horizon)).json()["model"]["name"]
        for horizon in (5, 10, 30, 60)
    }
    assert chosen == {5: "near", 10: "near", 30: "far", 60: "far"}
    without = client.post("/predict", json=body()).json()
    assert without["model"]["name"] == "far"


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "dot"),
        ({"frame_rate": "40"}, "dot"),
        ({"frame_rate": "41"}, "dot"),
        ({"frame_rate": "30"}, "dots"),
        ({"frame_rate": "120"}, "dots"),
        ({"frame_rate": "5"}, "dot"),
        ({"frame_rate": "30", "model": "dot"}, "dot"),
        ({"frame_rate": "30", "final": True}, "between"),
    ],
)
def test_auto_takes_the_model_that_is_told_the_rate(start, fields, name):
    models = [served(), served(name="between", frames=5, final_step=9)]
    client = start(lambda *_: Registry([*models, served_balls(frame_rates_hz=[15, 125])]))
    data = {key: value for key, value in fields.items() if key != "final"}
    final = "final" in fields
    images = moving_dot(frames=5 if final else 4)
    files = parts(images[:4])
    if final:
        files.append(("final_frame", ("f.png", images[4])))
    response = client.post("/predict", files=files, data=data)
    assert response.status_code == 200, response.text
    assert response.json()["model"]["name"] == name
