"""What every committed model must do, whatever it is."""

from pathlib import Path

import numpy as np
import pytest

from rollcast.manifest import FRAMES_INPUT, GOLDEN_FILE, MANIFEST_FILE, Manifest
from rollcast.ood import frame_stats
from rollcast.rollout import roll_out
from service.inference.onnx_runtime import open_predictor
from service.inference.rollout import Predictor, assemble
from service.settings import Settings

FOLDERS = sorted(path.parent for path in Settings().models_dir.glob("*/*/manifest.json"))


def test_there_are_models_and_all_are_served(client):
    models = client.get("/models").json()["models"]
    assert {(model["status"], model["reason"]) for model in models} == {("ready", None)}
    assert len(models) == len(FOLDERS)


@pytest.fixture(scope="module", params=FOLDERS, ids=lambda path: f"{path.parent.name}@{path.name}")
def folder(request) -> Path:
    return request.param


@pytest.fixture(scope="module")
def predictor(folder) -> Predictor:
    return open_predictor(folder, Manifest.read(folder / MANIFEST_FILE))


@pytest.fixture(scope="module")
def frames(folder) -> np.ndarray:
    """The golden frames: at least two requests."""
    with np.load(folder / GOLDEN_FILE) as golden:
        frames = golden[FRAMES_INPUT]
    assert len(frames) >= 2
    return frames


def forecast(predictor, frames, horizon):
    outputs = roll_out(predictor, frames, horizon)
    return assemble(outputs, predictor.manifest.covariance)


def test_shapes(predictor, frames):
    manifest = predictor.manifest
    result = forecast(predictor, frames, 3)
    assert result.positions.shape == (len(frames), manifest.objects, 3, 2)
    assert result.covariances.shape == (len(frames), manifest.objects, 3, 2, 2)
    assert ("angular_velocities" in result.outputs) == manifest.angular_velocity
    assert ("final_positions" in result.outputs) == (manifest.final_step is not None)


def test_the_state_is_the_manifests(predictor, frames):
    step = predictor.encode(frames[:2])
    for tensor in predictor.manifest.state:
        assert step.state[tensor.name].shape == (2, *tensor.shape)
        assert step.state[tensor.name].dtype == tensor.dtype


def test_the_same_batch_gives_the_same_bits(predictor, frames):
    first, second = (forecast(predictor, frames, 20) for _ in range(2))
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.covariances, second.covariances)


def test_a_request_alone_is_answered_as_in_a_batch(predictor, frames):
    horizon = predictor.manifest.trained_horizon
    together = forecast(predictor, frames, horizon)
    for index in range(len(frames)):
        alone = forecast(predictor, frames[index : index + 1], horizon)
        np.testing.assert_allclose(alone.positions[0], together.positions[index], atol=1e-2)


def test_requests_join_and_leave_between_steps(predictor, frames):
    """Continuous batching relies on it: the state has no axis but the batch that they share."""
    first, second = (predictor.encode(frames[index : index + 1]) for index in range(2))
    begun = predictor.advance(first.state, 3)
    together = {name: np.concatenate([begun.state[name], second.state[name]]) for name in begun[0]}
    joined = predictor.advance(together, 4).outputs["positions"]
    alone = [predictor.advance(begun.state, 4), predictor.advance(second.state, 4)]
    for index, steps in enumerate(alone):
        np.testing.assert_allclose(joined[:, index], steps.outputs["positions"][:, 0], atol=1e-2)


def test_steps_in_one_call_are_those_of_several(predictor, frames):
    state = predictor.encode(frames[:1]).state
    together = predictor.advance(state, 8).outputs
    for step in range(8):
        state, outputs = predictor.advance(state, 1)
        for name, values in outputs.items():
            np.testing.assert_array_equal(together[name][step], values[0])


def test_covariances_are_symmetric_and_positive(predictor, frames):
    covariances = forecast(predictor, frames, 40).covariances
    np.testing.assert_allclose(covariances, covariances.swapaxes(-1, -2), rtol=1e-4, atol=1e-6)
    assert np.linalg.eigvalsh(covariances).min() > 0


def test_a_manifest_tells_the_error_of_every_scenario(predictor):
    manifest = predictor.manifest
    rows = [row for row in manifest.metrics if row.split == "validation"]
    at_trained = {row.scenario for row in rows if row.horizon == manifest.trained_horizon}
    assert at_trained == set(manifest.scenarios)
    assert manifest.licence
    assert all(
        manifest.parity.max_abs_error[name] <= manifest.parity.tolerance[name]
        for name in manifest.output_names
    )


def test_golden_frames_are_in_distribution_and_their_negatives_are_not(predictor, frames):
    known, ood_detector = predictor.manifest.ood, predictor.ood_detector
    if known is None:
        assert ood_detector is None
        return
    assert known.false_alarm_rate <= 0.02
    for seen in frames:
        assert ood_detector.score(frame_stats(seen)) <= known.threshold
        assert ood_detector.score(frame_stats(255 - seen)) > known.threshold
