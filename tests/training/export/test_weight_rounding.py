"""Weights in 8 bits: what is rounded, what is stored, and what the runtime computes with."""

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import numpy_helper
from torch import nn

from training.export.weight_rounding import round_weights, store_in_bytes, stored_weights


@pytest.fixture
def layers() -> nn.Sequential:
    torch.manual_seed(3)
    convolution = nn.Conv2d(16, 40, 3)
    with torch.no_grad():
        convolution.weight[4] *= 1e-5
        convolution.weight[5] = 0
    return nn.Sequential(convolution, nn.Linear(128, 96), nn.Linear(8, 8))


@pytest.fixture
def graph(layers) -> onnx.ModelProto:
    """Linear, of 128 inputs, as the exporter writes it."""
    weight = numpy_helper.from_array(layers[1].weight.detach().numpy(), "1.weight")
    bias = numpy_helper.from_array(layers[1].bias.detach().numpy(), "1.bias")
    node = onnx.helper.make_node("Gemm", ["x", "1.weight", "1.bias"], ["y"], transB=1)
    x = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1, 128])
    y = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1, 96])
    made = onnx.helper.make_graph([node], "linear", [x], [y], [weight, bias])
    opset = onnx.helper.make_opsetid("", 20)
    return onnx.helper.make_model(made, opset_imports=[opset], ir_version=10)


def test_every_row_is_rounded_to_its_own_255_values(layers):
    before = {name: value.clone() for name, value in layers.state_dict().items()}
    round_weights(layers)
    after = layers.state_dict()
    for name in ("0.weight", "1.weight"):
        rows = before[name].flatten(1)
        step = rows.abs().amax(dim=1, keepdim=True) / 127
        # Half a step, and what the short scale costs at its far end.
        assert ((after[name].flatten(1) - rows).abs() <= 0.55 * step).all()
    assert not after["0.weight"][5].any()
    assert all(len(row.unique()) <= 255 for row in after["1.weight"])
    for name in ("0.bias", "1.bias", "2.weight"):
        assert torch.equal(after[name], before[name])


def test_rounding_again_changes_nothing(layers):
    round_weights(layers)
    once = {name: value.clone() for name, value in layers.state_dict().items()}
    round_weights(layers)
    assert all(torch.equal(value, once[name]) for name, value in layers.state_dict().items())


def test_rounded_weights_are_stored_in_a_quarter_and_lose_nothing(layers, graph):
    round_weights(layers)
    weight = layers[1].weight.detach()
    graph.graph.initializer[0].CopyFrom(numpy_helper.from_array(weight.numpy(), "1.weight"))
    before = graph.ByteSize()
    plain = run(graph)
    store_in_bytes(graph.graph)
    onnx.checker.check_model(graph)
    assert graph.ByteSize() < before / 3
    np.testing.assert_array_equal(run(graph), plain)
    stored = stored_weights(graph.graph)
    assert stored.keys() == {"1.weight", "1.bias"}
    assert torch.equal(stored["1.weight"], weight)
    assert stored["1.weight"].dtype == torch.float32


def test_weights_that_are_not_rounded_stay_as_they_are(graph):
    before = graph.SerializeToString()
    store_in_bytes(graph.graph)
    assert graph.SerializeToString() == before


def test_the_runtime_restores_the_weights_when_it_loads(layers, graph, tmp_path):
    round_weights(layers)
    weight = layers[1].weight.detach().numpy()
    graph.graph.initializer[0].CopyFrom(numpy_helper.from_array(weight, "1.weight"))
    store_in_bytes(graph.graph)
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "loaded.onnx")
    onnxruntime.InferenceSession(graph.SerializeToString(), options)
    loaded = onnx.load(tmp_path / "loaded.onnx")
    assert [node.op_type for node in loaded.graph.node] == ["Gemm"]


def run(model: onnx.ModelProto) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    x = np.linspace(-1, 1, 128, dtype=np.float32)[None]
    (y,) = session.run(["y"], {"x": x})
    assert isinstance(y, np.ndarray)
    return y
