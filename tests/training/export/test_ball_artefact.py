"""One artefact for one to eight balls: from a network to what the service answers with it."""

import base64
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient

from rollcast.manifest import BALL_FILES, MANIFEST_FILE, Manifest
from service.app import create_app
from service.serving.loading import load_registry
from service.settings import Settings
from tests.service.conftest import wait_until_ready
from tests.training.conftest import SCENES
from training.evaluation.any_ball import TorchFinder
from training.evaluation.evaluate import evaluation_sets
from training.export.ball_artefact import TrainedBalls, export_balls
from training.export.load import any_ball_from
from training.networks.any_ball import AnyBallNet

MODELS = Path(__file__).parents[3] / "models"
HORIZON = 4


@pytest.fixture(scope="module")
def network() -> AnyBallNet:
    """Motion as it is committed; the detector has learned nothing yet."""
    return any_ball_from(MODELS)


@pytest.fixture(scope="module")
def models(runs, network, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    (part,) = evaluation_sets(("hemisphere",), 1, None, "validation", SCENES, 1)
    sets = {1: [replace(part, windows=part.windows[:5], line=part.line[:5])]}
    trained = TrainedBalls("balls", network, 10, HORIZON, {"hemisphere-1": 5}, seed=1)
    export_balls(trained, folder / "balls" / "1", 1, sets, sets, 0.2)
    return folder


def test_the_manifest_tells_that_the_number_of_balls_is_free(models):
    manifest = Manifest.read(models / "balls" / "1" / MANIFEST_FILE)
    assert (manifest.objects, manifest.max_objects) == (1, 8)
    assert set(manifest.files) == set(BALL_FILES)
    assert [n for n in range(12) if manifest.follows(n)] == list(range(1, 9))
    assert set(manifest.parity.max_abs_error) == {"positions", "covariances", "angular_velocities"}


def test_the_service_proves_the_artefact_before_it_serves_it(models):
    (model,) = load_registry(models).models
    assert model.status == "ready", model.reason


@pytest.mark.parametrize(("number", "rate"), [(1, 40), (2, 20), (5, 40), (8, 20)])
def test_the_service_answers_what_torch_computes(models, network, number, rate):
    generator = np.random.default_rng(number)
    frames = generator.integers(0, 256, (4, 150, 200, 3), dtype=np.uint8)
    at = np.stack([generator.uniform(20, 180, number), generator.uniform(20, 130, number)], axis=1)
    finder = TorchFinder(network)
    balls, said = finder.find(frames, (at - (100, 75)) / 100)
    spacing = 40 // rate
    made = finder.forecast(balls, said, spacing * (HORIZON - 1) + 1, spacing)["positions"]
    expected = made[:, ::spacing] * (200 / 128) - (0, 25)
    images = [io.BytesIO() for _ in frames]
    for image, frame in zip(images, frames, strict=True):
        Image.fromarray(frame).save(image, "PNG")
    body = {
        "frames": [base64.b64encode(image.getvalue()).decode() for image in images],
        "balls": [{"x": x, "y": y} for x, y in at.tolist()],
        "horizon": HORIZON,
        "frame_rate": rate,
    }
    with TestClient(create_app(Settings(models_dir=models))) as client:
        wait_until_ready(client)
        response = client.post("/predict", json=body)
    assert response.status_code == 200, response.text
    got = np.array([ball["positions"] for ball in response.json()["objects"]])
    assert np.allclose(got, expected, atol=0.02)
