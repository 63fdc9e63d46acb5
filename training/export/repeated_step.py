"""A graph of one step as a graph of as many as are asked for: one call per rollout, not per step.

The step becomes the body of a ``Loop``. Its parameters stay initialisers of the graph itself.
"""

import onnx
from onnx import TensorProto, helper

from rollcast.manifest import NEXT_PREFIX, STEPS_INPUT

_BODY_SUFFIX = "_of_step"
"""Names inside a loop differ from those around it."""


def repeat_step(step: onnx.ModelProto) -> onnx.ModelProto:
    """Return a graph that takes ``steps`` steps.

    Parameters
    ----------
    step
        State NAME to ``next_NAME`` and outputs [B, N, ...]; its nodes are in topological order.

    Returns
    -------
    onnx.ModelProto
        Input ``steps`` (int64, no axis) and the state, to the state after all steps and the outputs
        [T, B, N, ...] of each.
    """
    graph = step.graph
    state = [one.name for one in graph.input]
    carried = [NEXT_PREFIX + name for name in state]
    made = {one.name: one for one in graph.output}
    outputs = [name for name in made if name not in carried]
    constant = {one.name for one in graph.initializer} | {""}
    around, body = onnx.GraphProto(name="rollout"), onnx.GraphProto(name="step")
    around.initializer.extend(graph.initializer)
    for node in graph.node:
        hoisted = constant.issuperset(node.input)
        if hoisted:
            constant.update(node.output)
        (around if hoisted else body).node.append(node)
    for node in body.node:
        node.input[:] = [_inside(name, constant) for name in node.input]
        node.output[:] = [_inside(name, constant) for name in node.output]
    body.input.append(helper.make_tensor_value_info("step", TensorProto.INT64, []))
    body.input.append(helper.make_tensor_value_info("goes_on", TensorProto.BOOL, []))
    body.input.extend(_renamed(one, _inside(one.name, constant)) for one in graph.input)
    body.node.append(helper.make_node("Identity", ["goes_on"], ["still_goes_on"]))
    body.output.append(helper.make_tensor_value_info("still_goes_on", TensorProto.BOOL, []))
    body.output.extend(
        _renamed(made[name], _inside(name, constant)) for name in (*carried, *outputs)
    )
    around.input.append(helper.make_tensor_value_info(STEPS_INPUT, TensorProto.INT64, []))
    around.input.extend(graph.input)
    around.node.append(
        helper.make_node("Loop", [STEPS_INPUT, "", *state], [*carried, *outputs], body=body)
    )
    around.output.extend(made[name] for name in carried)
    around.output.extend(_of_steps(made[name]) for name in outputs)
    rollout = onnx.ModelProto()
    rollout.CopyFrom(step)
    rollout.graph.CopyFrom(around)
    onnx.checker.check_model(rollout)
    return rollout


def _inside(name: str, constant: set[str]) -> str:
    return name if name in constant else name + _BODY_SUFFIX


def _renamed(value: onnx.ValueInfoProto, name: str) -> onnx.ValueInfoProto:
    renamed = onnx.ValueInfoProto()
    renamed.CopyFrom(value)
    renamed.name = name
    return renamed


def _of_steps(value: onnx.ValueInfoProto) -> onnx.ValueInfoProto:
    """Return an output with an axis for the steps in front."""
    tensor = value.type.tensor_type
    axes = [one.dim_param or one.dim_value for one in tensor.shape.dim]
    return helper.make_tensor_value_info(value.name, tensor.elem_type, ["steps", *axes])
