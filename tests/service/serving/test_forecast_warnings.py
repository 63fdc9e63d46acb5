"""Reasons to trust a forecast less; those of the horizon and the rate are in test_predict.py."""

import json

import numpy as np
import pytest

from rollcast.ood import OodDetector, frame_stats
from service.serving.registry import Model, Registry
from tests.service import samples

NUMBERS = 3 + 1 + 7


def ood_detector(frames: np.ndarray) -> OodDetector:
    """One kind of scenes whose mean is what some frames look like."""
    components = np.eye(192, dtype=np.float32)[:3]
    known = OodDetector(
        frame_stats(frames).thumbnail[None],
        components[None],
        np.zeros((1, NUMBERS), np.float32),
        np.eye(NUMBERS, dtype=np.float32)[None],
    )
    seen = frame_stats(frames)
    mean = np.concatenate([np.zeros(3), [np.log(1e-3)], seen.texture])
    return OodDetector(known.thumbnail, known.components, mean[None], known.whitening)


@pytest.fixture
def client(start):
    frames = np.stack([samples.dot(40 + 2 * index, 60 + index) for index in range(4)])
    described = samples.manifest(
        ood={"threshold": 1.5, "false_alarm_rate": 0.006, "test_windows": 1500},
        files=dict.fromkeys([*samples.HASHED_FILES, "ood.npz"], 64 * "0"),
    )
    predictor = samples.DotPredictor(described, ood_detector(frames))
    return start(lambda *_: Registry([Model("dot", 1, described, predictor)]))


def warnings(client, images):
    answer = client.post("/predict", json=samples.body(images, horizon=2))
    assert answer.status_code == 200, answer.text
    return answer.json()["warnings"]


def test_frames_in_distribution_carry_no_warning(client):
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


def test_auto_has_another_model_for_ood_frames_alone(start):
    frames = np.stack([samples.dot(40 + 2 * index, 60 + index) for index in range(4)])
    fields = {
        "ood": {"threshold": 1.5, "false_alarm_rate": 0.006, "test_windows": 1500},
        "files": dict.fromkeys([*samples.HASHED_FILES, "ood.npz"], 64 * "0"),
    }
    usual = samples.manifest(**fields)
    robust = samples.manifest(
        version=2, default=False, random_appearances=True, validation_error_px=9.0, **fields
    )
    models = [
        Model("dot", one.version, one, samples.DotPredictor(one, ood_detector(frames)))
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


PLACED = {"threshold_px": 0.5, "false_alarm_rate": 0.004, "test_windows": 400}


def of_lost_balls(start, sigma: float, *, robust: bool):
    """A service of a model that knows the place to ``sigma``, and perhaps of a robust one."""
    usual = samples.manifest(place_uncertainty=PLACED)
    models = [Model("dot", 1, usual, samples.DotPredictor(usual, sigma=sigma))]
    if robust:
        other = samples.manifest(
            version=2, default=False, random_appearances=True, validation_error_px=9.0,
            place_uncertainty=PLACED,
        )  # fmt: skip
        models.append(Model("dot", 2, other, samples.DotPredictor(other, sigma=sigma)))
    return start(lambda *_: Registry(models))


def lost_warning(model: str, sigma: str) -> str:
    return (
        f"{model} may have lost a ball: the standard deviation of its position at t = 0 is "
        f"{sigma} px of 128, above 0.5 (false-alarm rate 0.4 %). The forecast may follow another "
        "object."
    )


@pytest.mark.parametrize("stream", [False, True])
def test_auto_has_another_model_look_for_balls_that_are_lost(start, stream):
    client = of_lost_balls(start, 3, robust=True)
    asked = samples.body(horizon=2)
    if stream:
        events = client.post("/predict/stream", json=asked).text.strip().split("\n\n")
        *steps, done = [json.loads(event.split("data: ")[1]) for event in events]
        assert [step["step"] for step in steps] == [0, 1]
    else:
        done = client.post("/predict", json=asked).json()
        assert len(done["objects"][0]["positions"]) == 2
    assert done["model"]["version"] == 2
    assert done["warnings"][0] == lost_warning("dot@1", "3")
    assert done["warnings"][1].startswith("dot@2 forecasts in place of dot@1")
    # The other model has not found it either, and is replaced by none.
    assert done["objects"][0]["warnings"] == [lost_warning("dot@2", "3")]
    timing = done["timing_ms"]
    assert timing["decode"] + timing["encode"] + timing["rollout"] == pytest.approx(timing["total"])


def test_a_place_that_is_known_replaces_no_model(start):
    client = of_lost_balls(start, 0.4, robust=True)
    done = client.post("/predict", json=samples.body(horizon=2)).json()
    assert (done["model"]["version"], done["warnings"]) == (1, [])
    assert done["objects"][0]["warnings"] == []


@pytest.mark.parametrize(("robust", "model"), [(False, "auto"), (True, "dot@1")])
def test_a_lost_ball_carries_the_warning_where_no_model_replaces(start, robust, model):
    client = of_lost_balls(start, 3, robust=robust)
    done = client.post("/predict", json=samples.body(horizon=2, model=model)).json()
    assert (done["model"]["version"], done["warnings"]) == (1, [])
    assert done["objects"][0]["warnings"] == [lost_warning("dot@1", "3")]
