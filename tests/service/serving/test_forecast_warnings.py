"""Reasons to trust a forecast less; those of the horizon and the rate are in test_predict.py."""

import numpy as np
import pytest

from rollcast.ood import Familiarity, frame_stats
from service.serving.registry import Model, Registry
from tests.service import samples

NUMBERS = 3 + 1 + 7


def familiarity(frames: np.ndarray) -> Familiarity:
    """One kind of scenes whose mean is what some frames look like."""
    components = np.eye(192, dtype=np.float32)[:3]
    known = Familiarity(
        frame_stats(frames).thumbnail[None],
        components[None],
        np.zeros((1, NUMBERS), np.float32),
        np.eye(NUMBERS, dtype=np.float32)[None],
    )
    seen = frame_stats(frames)
    mean = np.concatenate([np.zeros(3), [np.log(1e-3)], seen.texture])
    return Familiarity(known.thumbnail, known.components, mean[None], known.whitening)


@pytest.fixture
def client(start):
    frames = np.stack([samples.dot(40 + 2 * index, 60 + index) for index in range(4)])
    described = samples.manifest(
        unfamiliar={"threshold": 1.5, "false_alarm_rate": 0.006, "test_windows": 1500},
        files=dict.fromkeys([*samples.HASHED_FILES, "familiarity.npz"], 64 * "0"),
    )
    predictor = samples.DotPredictor(described, familiarity(frames))
    return start(lambda *_: Registry([Model("dot", 1, described, predictor)]))


def warnings(client, images):
    answer = client.post("/predict", json=samples.body(images, horizon=2))
    assert answer.status_code == 200, answer.text
    return answer.json()["warnings"]


def test_familiar_frames_carry_no_warning(client):
    assert warnings(client, samples.moving_dot()) == []


def test_frames_that_look_otherwise_do(client):
    noise = np.random.default_rng(0).integers(0, 256, (4, 64, 64, 3), np.uint8)
    (warning,) = warnings(client, [samples.png(frame) for frame in noise])
    assert "look unlike the training data of dot@1: their out-of-distribution score of " in warning
    assert "exceeds 1.5 (false-alarm rate 0.6 %)." in warning


def test_frames_in_which_nothing_moves_do(client):
    at_rest = [samples.png(samples.dot(40, 60))] * 4
    assert warnings(client, at_rest)[0] == (
        "Nothing moves in the four frames: their largest change is 0.0 of 255 levels of brightness."
    )


def test_the_stream_says_the_same(client):
    at_rest = samples.body([samples.png(samples.dot(40, 60))] * 4, horizon=2)
    whole = client.post("/predict", json=at_rest).json()["warnings"]
    assert whole
    assert whole[0] in client.post("/predict/stream", json=at_rest).text


def test_auto_has_another_model_for_unfamiliar_frames_alone(start):
    frames = np.stack([samples.dot(40 + 2 * index, 60 + index) for index in range(4)])
    fields = {
        "unfamiliar": {"threshold": 1.5, "false_alarm_rate": 0.006, "test_windows": 1500},
        "files": dict.fromkeys([*samples.HASHED_FILES, "familiarity.npz"], 64 * "0"),
    }
    usual = samples.manifest(**fields)
    robust = samples.manifest(
        version=2, default=False, random_appearances=True, validation_error_px=9.0, **fields
    )
    models = [
        Model("dot", one.version, one, samples.DotPredictor(one, familiarity(frames)))
        for one in (usual, robust)
    ]
    client = start(lambda *_: Registry(models))
    noise = np.random.default_rng(0).integers(0, 256, (4, 64, 64, 3), np.uint8)
    unlike = [samples.png(frame) for frame in noise]

    def answered(images, **options):
        answer = client.post("/predict", json=samples.body(images, horizon=2, **options)).json()
        return answer["model"]["version"], answer["warnings"]

    assert answered(samples.moving_dot()) == (1, [])
    version, told = answered(unlike)
    assert version == 2
    assert "look unlike the training data of dot@1" in told[0]
    assert told[1].startswith("dot@2 forecasts in place of dot@1")
    version, told = answered(unlike, model="dot")
    assert version == 1
    assert len(told) == 1
