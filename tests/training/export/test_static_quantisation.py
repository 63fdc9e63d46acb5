"""Perception in 8 bits, made of the committed one: what is quantised, and what that costs."""

from pathlib import Path

import numpy as np
import onnx
import pytest

from rollcast.manifest import GOLDEN_FILE, MANIFEST_FILE, PERCEPTION_FILE, ROLLOUT_FILE, Manifest
from training.export.onnx_graphs import Graphs
from training.export.static_quantisation import (
    KEPT_IN_FLOAT,
    LEAST_GAIN,
    MOST_LOSS_PX,
    write_quantised,
)

MODELS = Path(__file__).parents[3] / "models"
FIELDNET = MODELS / "fieldnet" / "1"


@pytest.fixture(scope="module")
def golden():
    with np.load(FIELDNET / GOLDEN_FILE) as stored:
        return {name: stored[name] for name in stored.files}


@pytest.fixture(scope="module")
def perception(golden, tmp_path_factory):
    path = tmp_path_factory.mktemp("quantised") / PERCEPTION_FILE
    write_quantised(FIELDNET / PERCEPTION_FILE, path, golden["frames"])
    return path


def test_convolutions_read_8_bits_but_those_that_are_kept(perception):
    graph = onnx.load(perception).graph
    made_by = {name: node for node in graph.node for name in node.output}
    kept = 0
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    for node in convolutions:
        weight = made_by.get(node.input[1])
        if weight is not None and weight.op_type == "DequantizeLinear":
            assert made_by[node.input[0]].op_type == "DequantizeLinear"
        else:
            kept += 1
    assert kept == len(KEPT_IN_FLOAT)
    assert len(convolutions) > 4 * kept


def test_it_reads_nearly_what_the_perception_in_float32_reads(perception, golden):
    # Its ranges were measured on these very frames, so little of the difference is left to chance.
    for file in FIELDNET.glob("*.onnx"):
        if file.name != PERCEPTION_FILE:
            (perception.parent / file.name).write_bytes(file.read_bytes())
    positions = Graphs(perception.parent).roll(golden["frames"], 10)["positions"]
    difference = np.abs(positions - golden["positions"][:, :, :10])
    assert 0 < difference.max() < 0.5


COMMITTED = [Manifest.read(path) for path in sorted(MODELS.glob(f"*/*/{MANIFEST_FILE}"))]
QUANTISED = [manifest for manifest in COMMITTED if "quantised" in manifest.training]


@pytest.mark.parametrize("manifest", QUANTISED, ids=lambda manifest: manifest.label)
def test_a_committed_version_in_8_bits_is_worth_it(manifest):
    said = manifest.training["quantised"]
    assert not manifest.default
    assert isinstance(said, str)
    label, _, figures = said.partition(": ")
    assert float(figures.partition(" ")[0]) >= LEAST_GAIN
    name, _, version = label.partition("@")
    of = Manifest.read(MODELS / name / version / MANIFEST_FILE)
    assert manifest.files[ROLLOUT_FILE] == of.files[ROLLOUT_FILE]
    for row, before in zip(manifest.metrics, of.metrics, strict=True):
        if (row.split, row.horizon) == ("validation", 20):
            assert row.position_error_px <= before.position_error_px + MOST_LOSS_PX
