"""The paper's networks: sizes, initial weights from VGG16, gradients."""

import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from training.networks.task import Task
from training.networks.vgg import HEADS, VGG16, VggEncoder, load_imagenet, paper_family

CONVOLUTIONS = sum(len(widths) for widths in VGG16)
TORCHVISION_LAYERS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
"""Indices of the convolutions in torchvision's ``vgg16().features``."""


def test_the_convolution_base_has_vgg16s_parameters():
    assert sum(p.numel() for p in VggEncoder(1, 1, 512).parameters()) == 14_714_688
    assert sum(p.numel() for p in VggEncoder(4, 1, 512).parameters()) == 14_714_688 + 9 * 9 * 64


@pytest.mark.parametrize(("objects", "channels"), [(1, 512), (3, 256)])
@pytest.mark.parametrize("name", HEADS)
def test_shapes_and_gradients(name, objects, channels):
    torch.manual_seed(0)
    task = Task(objects, final_step=39 if name == "interpnet" else None)
    family = paper_family({"it": name}, task)
    predictor = family.networks()["it"]
    frames = torch.randint(0, 256, (1, task.frames, 128, 128, 3), dtype=torch.uint8)
    assert predictor.start(frames).s.shape == (1, objects, channels, 8, 8)
    forecast = predictor(frames, 3)
    assert forecast.positions.shape == (1, objects, 3, 2)
    assert forecast.angular_velocities.shape == (1, objects, 3, 3)
    sum(part.square().sum() for part in forecast if part is not None).backward()
    untouched = [n for n, p in predictor.named_parameters() if p.grad is None or not p.grad.any()]
    assert untouched == []


@pytest.fixture(scope="module")
def imagenet() -> dict[int, tuple[torch.Tensor, torch.Tensor]]:
    """Weights in the shapes of ImageNet's VGG16, which has three input channels."""
    generator = torch.Generator().manual_seed(1)
    widths = [3, *(width for block in VGG16 for width in block)]
    return {
        k: (
            torch.randn(widths[k + 1], widths[k], 3, 3, generator=generator),
            torch.randn(widths[k + 1], generator=generator),
        )
        for k in range(CONVOLUTIONS)
    }


def as_torchvision(imagenet, path):
    state = {"classifier.0.weight": torch.zeros(1)}
    for layer, (weight, bias) in zip(TORCHVISION_LAYERS, imagenet.values(), strict=True):
        state |= {f"features.{layer}.weight": weight, f"features.{layer}.bias": bias}
    torch.save(state, path)


def as_keras_onnx(imagenet, path):
    names = [f"block{b + 1}_conv{k + 1}" for b, w in enumerate(VGG16) for k in range(len(w))]
    initialisers = []
    for name, (weight, bias) in zip(names, imagenet.values(), strict=True):
        kernel = f"functional_1/{name}_1/convolution/ReadVariableOp:0"
        initialisers.append(numpy_helper.from_array(weight.numpy(), kernel))
        initialisers.append(numpy_helper.from_array(bias.numpy(), f"functional_1/{name}_1/bias:0"))
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    node = helper.make_node("Identity", ["x"], ["y"])
    result = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    graph = helper.make_graph([node], "vgg", [value], [result], initialisers)
    onnx.save(helper.make_model(graph), path)


@pytest.mark.parametrize("write", [as_torchvision, as_keras_onnx])
def test_imagenets_weights_fill_all_but_the_first_convolution(imagenet, write, tmp_path):
    path = tmp_path / ("vgg16.onnx" if write is as_keras_onnx else "vgg16.pth")
    write(imagenet, path)
    encoder = VggEncoder(4, 1, 512)
    first = encoder.blocks[0][0].weight.clone()
    assert load_imagenet(encoder, path) == CONVOLUTIONS - 1
    own = [convolution for block in encoder.blocks for convolution in block]
    torch.testing.assert_close(own[0].weight, first, rtol=0, atol=0)
    for convolution, (weight, bias) in list(zip(own, imagenet.values(), strict=True))[1:]:
        torch.testing.assert_close(convolution.weight.data, weight, rtol=0, atol=0)
        torch.testing.assert_close(convolution.bias.data, bias, rtol=0, atol=0)
    # conv5's last layer is made anew for several balls.
    assert load_imagenet(VggEncoder(4, 3, 256), path) == CONVOLUTIONS - 2


def test_a_file_without_a_convolution_is_refused(imagenet, tmp_path):
    path = tmp_path / "vgg16.pth"
    torch.save({"features.0.weight": torch.zeros(1), "features.0.bias": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="lacks convolution 2"):
        load_imagenet(VggEncoder(4, 1, 512), path)
