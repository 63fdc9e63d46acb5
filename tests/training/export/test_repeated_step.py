"""A graph of many steps against the closed form of one."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from training.export.repeated_step import repeat_step


@pytest.fixture(scope="module")
def rollout():
    """A position that doubles its way at each step: velocity * (3 - 1), position + velocity."""
    state = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", 2])
        for name in ("position", "velocity")
    ]
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", 2])
        for name in ("next_position", "next_velocity", "positions")
    ]
    nodes = [
        helper.make_node("Sub", ["three", "one"], ["two"]),
        helper.make_node("Mul", ["velocity", "two"], ["next_velocity"]),
        helper.make_node("Add", ["position", "next_velocity"], ["next_position"]),
        helper.make_node("Identity", ["next_position"], ["positions"]),
    ]
    weights = [
        numpy_helper.from_array(np.float32(number), name)
        for name, number in (("one", 1), ("three", 3))
    ]
    graph = helper.make_graph(nodes, "step", state, outputs, weights)
    step = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    return repeat_step(step)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_steps_follow_the_closed_form(rollout, steps):
    session = onnxruntime.InferenceSession(rollout.SerializeToString())
    start, velocity = np.array([[1, 2], [3, 4]], np.float32), np.ones((2, 2), np.float32)
    given = {"steps": np.array(steps), "position": start, "velocity": velocity}
    position, last, positions = session.run(None, given)
    ways = 2.0 ** np.arange(2, steps + 2) - 2
    np.testing.assert_array_equal(positions, start + ways[:, None, None])
    np.testing.assert_array_equal(position, positions[-1])
    np.testing.assert_array_equal(last, 2.0**steps * velocity)


def test_parameters_keep_their_names_and_constants_are_computed_once(rollout):
    assert {one.name for one in rollout.graph.initializer} == {"one", "three"}
    assert [node.op_type for node in rollout.graph.node] == ["Sub", "Loop"]
    (loop,) = (node for node in rollout.graph.node if node.op_type == "Loop")
    body = next(one.g for one in loop.attribute if one.name == "body")
    assert "Sub" not in {node.op_type for node in body.node}
    onnx.checker.check_model(rollout)
