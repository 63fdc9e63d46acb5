"""The main path and the worst requests, with the real models."""

import base64
import json

import numpy as np
import pytest

from tests.service.http.test_refusals import PREDICT
from tests.service.samples import png


@pytest.fixture(scope="session")
def scene(client):
    answer = client.post("/simulate", json={"scenario": "hemisphere", "seed": 7})
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_frames_of_simulate_can_be_posted_unchanged(client, scene):
    answer = client.post("/predict", json={"frames": scene["frames"][:4]}).json()
    (ball,) = answer["objects"]
    assert len(ball["positions"]) == 40
    assert ball["covariance_source"] == "predicted", "auto takes a model with its own covariance"
    assert answer["frame_size"] == scene["frame_size"]


def test_multipart_and_json_agree_to_the_bit(client, scene):
    files = [base64.b64decode(frame) for frame in scene["frames"][:4]]
    by_parts = client.post("/predict", files=[("frames", ("f.png", file)) for file in files])
    by_json = client.post("/predict", json={"frames": scene["frames"][:4]})
    assert by_parts.json()["objects"] == by_json.json()["objects"]


def test_every_model_answers_by_its_name(client, scene):
    for model in client.get("/models").json()["models"]:
        if model["frames"] == 4 and model["objects"] == 1:
            label = f"{model['name']}@{model['version']}"
            answer = client.post("/predict", json={"model": label, "frames": scene["frames"][:4]})
            assert answer.status_code == 200, answer.text
            assert answer.json()["model"]["name"] == model["name"]


# The committed models read rectangles: "auto" sends them to the one for any number of balls.
CASES = [case for case in PREDICT if case not in ("too large", "not square")]


@pytest.mark.parametrize("case", CASES)
def test_bad_requests_change_nothing(client, scene, case):
    request, status, slug, _ = PREDICT[case]
    good = {"frames": scene["frames"][:4], "horizon": 3}
    before = client.post("/predict", json=good).json()["objects"]
    response = client.post("/predict", **request)
    assert (response.status_code, response.json()["type"]) == (status, f"/problems/{slug}")
    assert client.post("/predict", json=good).json()["objects"] == before


def test_rectangles_are_for_the_model_that_reads_them(client):
    picture = np.full((240, 320, 3), 40, np.uint8)
    picture[100:120, 150:170] = 220
    frames = [base64.b64encode(png(picture)).decode()] * 4
    answer = client.post("/predict", json={"frames": frames, "horizon": 3}).json()
    assert (answer["model"]["name"], answer["frame_size"]) == ("any-ball", [320, 240])
    named = client.post("/predict", json={"frames": frames, "model": "fieldnet"})
    assert (named.status_code, named.json()["field"]) == (422, "frames[0]")


def test_a_body_above_the_default_limit(client):
    response = client.post("/predict", content=bytes(65 * 2**20), headers=JSON)
    assert response.status_code == 413


JSON = {"content-type": "application/json"}


def test_the_description_of_the_api_is_the_committed_one(client):
    from pathlib import Path

    committed = json.loads((Path(__file__).parent / "openapi.json").read_text())
    assert client.get("/openapi.json").json() == committed, (
        "if this change of the API is meant, run: python -m tests.contract.write_openapi"
    )
