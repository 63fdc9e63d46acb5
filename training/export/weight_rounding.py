"""How a network's weights lie in its exported graphs: large ones in 8 bits (decision 0017).

A row of a weight (an output channel's share) is stored as whole numbers from -127 to 127 and a
scale. The network is rounded to such values before it is exported, so nothing is lost by storing.
"""

from collections.abc import Iterable

import numpy as np
import onnx
import torch
from onnx import numpy_helper

LARGEST = 127
SCALE = "/scale"
"""Suffix of a parameter's name for the scales of its rows."""
_SMALLEST_ROUNDED = 4096
"""Parameters of a tensor for which a scale and two nodes are worth it."""
_SCALE_DIGITS = 12
"""Binary digits of a scale: so few that its products with whole numbers are exact in float32."""


def round_weights(modules: Iterable[torch.nn.Module]) -> None:
    """Round the large weights of modules to values that 8 bits and a scale a row hold."""
    for module in modules:
        for parameter in module.parameters():
            if parameter.numel() >= _SMALLEST_ROUNDED:
                whole, scale = _in_bytes(parameter.detach().numpy())
                parameter.data = torch.from_numpy(whole * scale)


def store_in_bytes(graph: onnx.GraphProto) -> None:
    """Store the weights that 8 bits and a scale a row hold exactly as such.

    ONNX Runtime makes float32 of them once, when it loads the graph. The operator for it,
    DequantizeLinear, would run with every request: the runtime leaves it for kernels of 8 bits.
    """
    for initialiser in list(graph.initializer):
        value = numpy_helper.to_array(initialiser)
        if value.dtype != np.float32 or value.size < _SMALLEST_ROUNDED:
            continue
        whole, scale = _in_bytes(value)
        if not np.array_equal(whole * scale, value):
            continue
        name = initialiser.name
        rename(graph, name, f"{name}/float32")
        initialiser.CopyFrom(numpy_helper.from_array(whole, name))
        graph.initializer.append(numpy_helper.from_array(scale, name + SCALE))
        cast = onnx.helper.make_node("Cast", [name], [f"{name}/cast"], to=onnx.TensorProto.FLOAT)
        scaled = onnx.helper.make_node("Mul", [f"{name}/cast", name + SCALE], [f"{name}/float32"])
        graph.node.insert(0, scaled)
        graph.node.insert(0, cast)


def stored_weights(graph: onnx.GraphProto) -> dict[str, torch.Tensor]:
    """Return the values of a graph's initialisers by name, float32 however they are stored."""
    values = {one.name: numpy_helper.to_array(one) for one in graph.initializer}
    return {
        name: torch.from_numpy(np.asarray(value * values.get(name + SCALE, 1), np.float32))
        for name, value in values.items()
        if not name.endswith(SCALE)
    }


def rename(graph: onnx.GraphProto, old: str, new: str) -> None:
    """Let every node read ``new`` where it read ``old``."""
    for node in graph.node:
        for place, name in enumerate(node.input):
            if name == old:
                node.input[place] = new


def _in_bytes(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest whole numbers of every row, int8, and the rows' scales, float32."""
    rows = value.astype(np.float32)
    largest = np.abs(rows).max(axis=tuple(range(1, rows.ndim)), keepdims=True)
    digits, exponent = np.frexp(largest / np.float32(LARGEST))
    short = np.ldexp(np.round(np.ldexp(digits, _SCALE_DIGITS)), exponent - _SCALE_DIGITS)
    scale = np.where(largest > 0, short, 1).astype(np.float32)
    whole = np.clip(np.round(rows / scale), -LARGEST, LARGEST)
    return whole.astype(np.int8), scale
