import gc
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
import pytest

from rollcast.manifest import (
    ENCODER_FILE,
    EYE_FILE,
    GOLDEN_FILE,
    MANIFEST_FILE,
    STEP_FILE,
    Manifest,
)
from service import runtime
from service.runtime import OnnxPredictor

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture
def opened(monkeypatch):
    """Names of the graphs that are opened, with no eye open before."""
    names: list[str] = []
    open_session = runtime._session

    def note(path):
        names.append(path.name)
        return open_session(path)

    monkeypatch.setattr(runtime, "_session", note)
    monkeypatch.setattr(runtime, "_eyes", WeakValueDictionary())
    return names


def predictor(name: str) -> OnnxPredictor:
    folder = MODELS / name / "1"
    return OnnxPredictor(folder, Manifest.read(folder / MANIFEST_FILE))


def test_models_with_the_same_eye_share_it(opened):
    first, second = predictor("fieldnet"), predictor("posnet")
    assert opened == [EYE_FILE, ENCODER_FILE, STEP_FILE, ENCODER_FILE, STEP_FILE]
    for name, model in (("fieldnet", first), ("posnet", second)):
        with np.load(MODELS / name / "1" / GOLDEN_FILE) as golden:
            outputs = model.encode(golden["frames"]).outputs
            difference = outputs["positions"] - golden["positions"][:, :, 0]
        assert np.abs(difference).max() < 0.01


def test_an_eye_that_nobody_uses_is_let_go(opened):
    first, other = predictor("fieldnet"), predictor("fieldnet-2")
    assert opened.count(EYE_FILE) == 2
    del first
    gc.collect()
    assert len(runtime._eyes) == 1
    del other
    gc.collect()
    assert not runtime._eyes
