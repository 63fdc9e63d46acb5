import gc
import threading
import warnings
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
import pytest

from rollcast.manifest import (
    ENCODER_FILE,
    GOLDEN_FILE,
    MANIFEST_FILE,
    PERCEPTION_FILE,
    ROLLOUT_FILE,
    Manifest,
)
from service.inference import onnx_runtime
from service.inference.onnx_runtime import OnnxPredictor, check_provider, open_predictor

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture
def opened(monkeypatch):
    """Names of the graphs that are opened for one core, with no perception graph open before."""
    names: list[str] = []
    open_session = onnx_runtime._session

    def note(graph, provider, threads=1, **options):
        if threads == 1:
            names.append(PERCEPTION_FILE if isinstance(graph, bytes) else graph.name)
        return open_session(graph, provider, threads, **options)

    monkeypatch.setattr(onnx_runtime, "_session", note)
    monkeypatch.setattr(onnx_runtime, "_perceptions", WeakValueDictionary())
    return names


def predictor(name: str) -> OnnxPredictor:
    folder = MODELS / name / "1"
    return OnnxPredictor(folder, Manifest.read(folder / MANIFEST_FILE))


def test_models_with_the_same_perception_share_it_whether_they_see_a_final_frame_or_not(opened):
    names = ("fieldnet", "posnet", "interpnet")
    models = [predictor(name) for name in names]
    assert opened == [PERCEPTION_FILE, *(3 * [ENCODER_FILE, ROLLOUT_FILE])]
    for name, model in zip(names, models, strict=True):
        with np.load(MODELS / name / "1" / GOLDEN_FILE) as golden:
            outputs = model.encode(golden["frames"]).outputs
            difference = outputs["positions"] - golden["positions"][:, :, 0]
        assert np.abs(difference).max() < 0.01


@pytest.mark.parametrize("name", ["fieldnet", "fieldnet-interpolation"])
def test_a_second_core_changes_no_bit(name):
    model = predictor(name)
    with np.load(MODELS / name / "1" / GOLDEN_FILE) as golden:
        frames = golden["frames"]
    model.encode(frames[:1], two_cores=True)
    for thread in threading.enumerate():
        if thread.name == "opens perception":
            thread.join()
    if onnx_runtime.PERCEPTION_CORES > 1:
        assert model._perception._two_cores is not model._perception._one_core
    for rows in (frames[:1], frames):
        alone, two_cores = model.encode(rows), model.encode(rows, two_cores=True)
        for mine, other in ((alone.state, two_cores.state), (alone.outputs, two_cores.outputs)):
            for key, value in mine.items():
                np.testing.assert_array_equal(value, other[key])


def test_an_unused_perception_graph_is_closed(opened):
    first, other = predictor("fieldnet"), predictor("fieldnet-2")
    assert opened.count(PERCEPTION_FILE) == 2
    del first
    gc.collect()
    assert len(onnx_runtime._perceptions) == 1
    del other
    gc.collect()
    assert not onnx_runtime._perceptions


@pytest.mark.parametrize("name", ["fieldnet", "any-ball"])
def test_sessions_use_the_execution_provider(name, monkeypatch):
    """ONNX Runtime's CPU package has a second provider, which leaves all operators to the CPU."""
    monkeypatch.setattr(onnx_runtime, "_perceptions", WeakValueDictionary())
    folder = MODELS / name / "1"
    manifest = Manifest.read(folder / MANIFEST_FILE)
    model = open_predictor(folder, manifest, "AzureExecutionProvider")
    sessions = [part for part in vars(model).values() if hasattr(part, "get_providers")]
    assert len(sessions) >= 2
    for session in sessions:
        assert session.get_providers() == ["AzureExecutionProvider", "CPUExecutionProvider"]


def test_a_missing_execution_provider_is_refused_with_those_that_exist():
    with pytest.raises(ValueError, match=r"CUDA.*has Azure.*, CPU.*onnxruntime-gpu"):
        check_provider("CUDAExecutionProvider")
    check_provider("CPUExecutionProvider")


def test_a_provider_that_does_not_start_is_not_replaced_by_the_cpu():
    step = MODELS / "fieldnet" / "1" / ROLLOUT_FILE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ONNX Runtime warns, and goes on without it
        with pytest.raises(RuntimeError, match="CUDAExecutionProvider does not start"):
            onnx_runtime._session(step, "CUDAExecutionProvider")
