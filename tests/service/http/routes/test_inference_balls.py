"""Prompts of the Open Inference Protocol: as those of /predict, in batches."""

import numpy as np
import pytest

from service.serving.registry import Registry
from tests.service.ball_samples import dots, files, served_balls
from tests.service.http.routes.test_inference import outputs_of, tensor
from tests.service.samples import body, served

STEP = np.array([1.5, 1.0])


@pytest.fixture
def client(start):
    return start(lambda *_: Registry([served(), served_balls()]))


def frames(*last: tuple[float, float]) -> np.ndarray:
    """One window of dots that end somewhere, [4, 128, 128, 3]."""
    back = np.arange(-3, 1)[None, :, None] * STEP
    return np.stack(dots(np.array(last, float)[:, None] + back, 128, 128))


def infer(client, windows: np.ndarray, balls: object = None, model: str = "dots"):
    inputs = [tensor("frames", windows), tensor("horizon", np.array([3]))]
    if balls is not None:
        inputs.append(tensor("balls", np.array(balls, np.float32)))
    return client.post(f"/v2/models/{model}/infer", json={"inputs": inputs})


def test_prompts_select_the_balls_of_every_window(client):
    windows = np.stack([frames((40, 50), (90, 30)), frames((70, 100), (20, 60))])
    points = [[(91, 31), (41, 49)], [(70, 101), (21, 60)]]
    positions = outputs_of(infer(client, windows, points))["positions"]
    assert positions.shape == (2, 2, 3, 2)
    for window, prompts, made in zip(windows, points, positions, strict=True):
        asked = body(files(list(window)), horizon=3, model="dots", balls=[
            {"x": x, "y": y} for x, y in prompts
        ])  # fmt: skip
        objects = client.post("/predict", json=asked).json()["objects"]
        assert np.allclose(made, [ball["positions"] for ball in objects], atol=1e-3)


def test_the_metadata_say_that_the_number_of_balls_is_free(client):
    told = client.get("/v2/models/dots").json()
    assert {"name": "balls", "datatype": "FP32", "shape": [-1, -1, 2]} in told["inputs"]
    shapes = {output["name"]: output["shape"] for output in told["outputs"]}
    assert shapes["positions"] == [-1, -1, -1, 2]
    others = client.get("/v2/models/dot").json()
    assert "balls" not in {one["name"] for one in others["inputs"]}


@pytest.mark.parametrize(
    ("balls", "message"),
    [
        ([[(40, 50)]] * 2, "expected 1 on the first axis, as many as frames"),
        ([[(40, 129)]], "expected points x, y of the frames, 0 to 128"),
        ([[(40, float("nan"))]], "inputs[1].data is null, expected numbers"),
        ([[(40, 50)] * 9], "the second axis 1 to 8"),
    ],
)
def test_wrong_prompts_are_named(client, balls, message):
    windows = frames((40, 50))[None]
    if np.isnan(np.array(balls)).any():
        given = tensor("balls", np.array(balls, np.float32)) | {"data": [40, None]}
        inputs = [tensor("frames", windows), given]
        response = client.post("/v2/models/dots/infer", json={"inputs": inputs})
    else:
        response = infer(client, windows, balls)
    assert response.status_code == 400
    assert message in response.json()["error"]


def test_other_models_take_no_prompts(client):
    response = infer(client, frames((40, 50))[None], [[(40, 50)]], model="dot")
    assert response.status_code == 400
    assert "one of frames, horizon" in response.json()["error"]
