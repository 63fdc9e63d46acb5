"""What a folder of artefacts becomes; the graphs themselves are tried in tests/contract."""

import hashlib
import os
import shutil
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from rollcast.manifest import CARD_FILE, ENCODER_FILE, GOLDEN_FILE, HASHED_FILES, MANIFEST_FILE
from rollcast.rollout import roll_out
from service.serving.loading import begin_loading, load_registry, model_names
from tests.service.samples import DotPredictor, dot, manifest

FRAMES = np.stack([dot(40 + 2 * index, 60 + index) for index in range(4)])[None]


@pytest.fixture
def write(tmp_path):
    """Write an artefact whose graphs are a DotPredictor."""

    def _write(name="dot", version=1, golden=None, **changes):
        folder = tmp_path / name / str(version)
        folder.mkdir(parents=True)
        described = manifest(name=name, version=version, **changes)
        predictor = DotPredictor(described)
        values = roll_out(predictor, FRAMES, 3)
        np.savez(folder / GOLDEN_FILE, frames=FRAMES, **(values | (golden or {})))
        for file in HASHED_FILES:
            if file != GOLDEN_FILE:
                (folder / file).write_text(f"{file} of {name}")
        hashes = {f: hashlib.sha256((folder / f).read_bytes()).hexdigest() for f in HASHED_FILES}
        described.model_copy(update={"files": hashes}).write(folder / MANIFEST_FILE)
        return folder

    return _write


def load(folder):
    return load_registry(folder, open_predictor=lambda _, described: DotPredictor(described))


def reason(tmp_path):
    (model,) = load(tmp_path).models
    assert model.predictor is None
    return model.reason


def test_a_whole_artefact_is_served_with_its_card(write, tmp_path):
    write()
    (model,) = load(tmp_path).models
    assert model.predictor is not None
    assert (model.label, model.reason, model.card) == ("dot@1", None, f"{CARD_FILE} of dot")


def test_versions_stand_side_by_side(write, tmp_path):
    write(version=2)
    write(version=10, default=False)
    write(name="another")
    labels = [model.label for model in load(tmp_path).models]
    assert labels == ["another@1", "dot@2", "dot@10"]


def test_other_folders_are_no_models(tmp_path):
    (tmp_path / "notes" / "draft").mkdir(parents=True)
    (tmp_path / "README.md").write_text("hello")
    assert load(tmp_path).models == ()


def test_one_that_is_refused_does_not_stop_the_others(write, tmp_path):
    (write(name="bad") / ENCODER_FILE).write_text("changed")
    write()
    bad, good = load(tmp_path).models
    assert bad.predictor is None
    assert good.predictor is not None


def test_a_changed_file_is_refused(write, tmp_path):
    (write() / ENCODER_FILE).write_text("changed")
    assert reason(tmp_path) == (
        "encoder.onnx is not the file that the manifest names: sha256 differs"
    )


def test_a_missing_file_is_refused(write, tmp_path):
    (write() / CARD_FILE).unlink()
    assert reason(tmp_path) == "MODEL_CARD.md is missing"


def test_a_folder_without_manifest_is_refused(tmp_path):
    (tmp_path / "dot" / "1").mkdir(parents=True)
    assert reason(tmp_path) == "manifest.json is missing"


def test_a_manifest_that_is_not_valid_is_refused(write, tmp_path):
    file = write() / MANIFEST_FILE
    file.write_text(file.read_text().replace('"objects": 1', '"objects": 7'))
    assert reason(tmp_path).startswith("manifest.json is not valid: objects: ")


def test_a_manifest_of_another_version_is_refused(write, tmp_path):
    write().rename(tmp_path / "dot" / "2")
    assert reason(tmp_path) == "manifest.json is that of dot@1"


def test_graphs_that_compute_something_else_are_refused(write, tmp_path):
    shifted = np.full((1, 1, 3, 2), 50, np.float32)
    write(golden={"positions": shifted})
    assert reason(tmp_path) == (
        "positions differs by 15 from the golden values, at most 0.001 is allowed"
    )


def test_golden_values_that_are_not_numbers_are_refused(write, tmp_path):
    write(golden={"covariances": np.full((1, 1, 3, 2, 2), np.nan, np.float32)})
    assert reason(tmp_path).startswith("covariances differs by nan")


def test_golden_values_of_another_shape_are_refused(write, tmp_path):
    write(golden={"angular_velocities": np.ones((1, 1, 2, 3), np.float32)})
    assert "has the shape (1, 1, 3, 3), golden (1, 1, 2, 3)" in reason(tmp_path)


class Harm:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path):
        self._path = path

    def __reduce__(self):
        return Path.touch, (self._path,)


def test_a_pickle_in_a_model_is_refused_and_not_run(write, tmp_path):
    left = tmp_path / "left"
    write(golden={"positions": np.array([Harm(left)], dtype=object)})
    assert "allow_pickle" in reason(tmp_path)
    assert not left.exists()


def test_whatever_the_runtime_raises_is_a_reason(write, tmp_path):
    write()

    def fail(_, __):
        raise RuntimeError("no such operator")

    (model,) = load_registry(tmp_path, open_predictor=fail).models
    assert model.reason == "cannot be loaded: no such operator"
    assert model.manifest is not None


def test_what_is_being_loaded_already_is_handed_over_once(tmp_path):
    folder = tmp_path / "dot" / "1"
    folder.mkdir(parents=True)
    load = begin_loading(tmp_path)
    assert [model.name for model in load(tmp_path).models] == ["dot"]
    folder.rmdir()
    assert not load(tmp_path).models


def test_a_folder_that_is_not_named_by_its_number_is_refused_beside_the_version(
    write, tmp_path, caplog
):
    write(version=1)
    shutil.copytree(tmp_path / "dot/1", tmp_path / "dot/01")
    shutil.copytree(tmp_path / "dot/1", tmp_path / "dot/007")
    models = {model.label: model for model in load(tmp_path).models}
    assert models.keys() == {"dot@1", "dot@7"}
    assert models["dot@1"].predictor is not None
    assert models["dot@7"].reason == "the folder 007 of version 7 must be named 7"
    assert "dot/01 is refused: the folder 01 of version 1 must be named 1" in caplog.text


def test_folders_with_endless_numbers_are_no_versions(write, tmp_path):
    write()
    (tmp_path / "dot" / ("1" * 200)).mkdir()
    (tmp_path / "dot" / "²").mkdir()
    (tmp_path / "dot" / "٣").mkdir()
    assert [model.label for model in load(tmp_path).models] == ["dot@1"]


@pytest.mark.parametrize("name", [MANIFEST_FILE, *HASHED_FILES])
@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "folder"])
def test_what_is_no_regular_file_is_refused_at_once(write, tmp_path, name, kind):
    path = write() / name
    path.unlink()
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "socket":
            short = tmp_path / "s"  # a socket's path may have 107 bytes
            with socket.socket(socket.AF_UNIX) as server:
                server.bind(str(short))
            short.rename(path)
        case "device":
            path.symlink_to("/dev/zero")
        case _:
            path.mkdir()
    write(name="good")
    began = time.monotonic()
    refused, served = sorted(load(tmp_path).models, key=lambda model: model.status)
    assert time.monotonic() - began < 10
    assert served.label == "good@1"
    assert name in refused.reason or "directory" in refused.reason


@pytest.mark.parametrize(
    "name", [b"caf\xff", b"a\nb", b".hidden", b"auto", b"a@b", b"a b", "größe".encode(), b"x" * 200]
)
def test_a_folder_that_no_request_can_name_is_left_out_and_told(write, tmp_path, caplog, name):
    write()
    shutil.copytree(tmp_path / "dot", tmp_path / os.fsdecode(name))
    assert [model.label for model in load(tmp_path).models] == ["dot@1"]
    assert model_names(tmp_path) == {"dot"}
    (record,) = caplog.records
    message = record.getMessage()
    assert ascii(os.fsdecode(name)) in message
    assert message.isascii()
    assert message.isprintable()


def test_what_is_refused_is_logged_when_the_models_are_handed_over(write, tmp_path, caplog):
    (write() / ENCODER_FILE).unlink()
    hand_over = begin_loading(tmp_path)
    time.sleep(0.5)
    assert caplog.records == [], "logging may not be configured before"
    hand_over(tmp_path)
    assert "dot@1 is refused" in caplog.text
