"""A network as the graphs that are exported, and the graphs run again.

Initialisers have the names of torch's parameters, so later training can start from the committed
artefact.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import torch
from jaxtyping import UInt8
from torch import Tensor

from rollcast.manifest import (
    ENCODER_FILE,
    FRAMES_INPUT,
    NEXT_PREFIX,
    PERCEPTION_FILE,
    ROLLOUT_FILE,
    STEPS_INPUT,
)
from rollcast.outputs import SPECS, OutputName
from rollcast.perception_io import FINALS, PLACES, run_perception
from rollcast.rollout import Arrays, Step, Steps, roll_out
from rollcast.trajectory import OBSERVED_FRAMES
from training.common.settings import keep_runtime_silent
from training.export.repeated_step import repeat_step
from training.export.weight_rounding import rename, store_in_bytes
from training.networks.perception import Perception, PerceptionNetwork, perceive
from training.networks.recurrent import Network, Observation, PerceptionOutput, State

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

STATE_NAMES = State._fields
READ_NAMES = PerceptionOutput._fields[1:-1]
"""Inputs of an encoder; with a final frame, the positions there too."""
_OWN_PREFIX = "network."


class PerceptionGraph(torch.nn.Module):
    """Perception graph, shared by all networks with the same perception weights."""

    def __init__(self, perception: Perception) -> None:
        super().__init__()
        self.perception = perception

    def forward(self, frames: Tensor) -> tuple[Tensor, ...]:
        """Return the positions in the last frame and READ_NAMES, as positional tensors."""
        positions, *read, _ = self.perception(frames)
        return positions[-1][:, :, -1], *read


class ReadEncoderGraph(torch.nn.Module):
    """Encoder graph of a network with a separate perception graph."""

    def __init__(self, network: PerceptionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        ground: Tensor,
        scene_constants: Tensor,
        centres: Tensor,
        velocities: Tensor,
        spins: Tensor,
        features: Tensor,
        finals: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        """Turn perception outputs into the state and the first observation, positional tensors."""
        perceived = PerceptionOutput(
            (), ground, scene_constants, centres, velocities, spins, features
        )
        state = self.network.begin(perceived, finals)
        return *state, *present(self.network.observe_first(state))


class EncoderGraph(torch.nn.Module):
    """The encoder's graph of any other network."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, frames: Tensor) -> tuple[Tensor, ...]:
        """Frames to the state and the first observation, as positional tensors."""
        state = self.network.start(frames)
        return *state, *present(self.network.observe_first(state))


class StepGraph(torch.nn.Module):
    """The step's graph."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, s: Tensor, p: Tensor) -> tuple[Tensor, ...]:
        """State to the next state and its observation, as positional tensors."""
        state = self.network.advance(State(s, p))
        return *state, *present(self.network.observe(state))


def write_graphs(predictor: Network, frames: Tensor, folder: Path) -> None:
    """Write the graphs of a network into an artefact's folder.

    Parameters
    ----------
    frames
        [B, K, 128, 128, 3], with which the network is traced.
    """
    outputs = list(first_observation(predictor, frames))
    encoded = [*STATE_NAMES, *outputs]
    if isinstance(predictor, PerceptionNetwork):
        (perception,) = (part for part in predictor.modules() if isinstance(part, Perception))
        graph = PerceptionGraph(perception)
        seen, read_names = (frames[:, :OBSERVED_FRAMES],), [PLACES, *READ_NAMES]
        write_graph(graph, seen, [FRAMES_INPUT], read_names, folder / PERCEPTION_FILE)
        with torch.inference_mode():
            (_, *read, _), finals = perceive(perception, frames)
        names = list(READ_NAMES)
        if finals is not None:
            names.append(FINALS)
            read.append(finals)
        encoder = ReadEncoderGraph(predictor)
        write_graph(encoder, tuple(read), names, encoded, folder / ENCODER_FILE)
    else:
        (folder / PERCEPTION_FILE).unlink(missing_ok=True)
        encoder = EncoderGraph(predictor)
        write_graph(encoder, (frames,), [FRAMES_INPUT], encoded, folder / ENCODER_FILE)
    with torch.inference_mode():
        state = tuple(predictor.start(frames))
    of_steps = [name for name in outputs if SPECS[name].is_per_step]
    stepped = [*(NEXT_PREFIX + name for name in STATE_NAMES), *of_steps]
    write_rollout_graph(StepGraph(predictor), state, stepped, folder / ROLLOUT_FILE)


def write_rollout_graph(
    step: torch.nn.Module,
    state: tuple[Tensor, ...],
    outputs: Sequence[str],
    path: Path,
    axes: Sequence[Mapping[int, object]] | None = None,
) -> None:
    """Write a graph of many steps from a module of one; parameters as of :func:`write_graph`."""
    write_graph(step, state, list(STATE_NAMES), outputs, path, axes)
    onnx.save(repeat_step(onnx.load(path)), path)


def write_graph(
    module: torch.nn.Module,
    arguments: tuple[Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    path: Path,
    axes: Sequence[Mapping[int, object]] | None = None,
) -> None:
    """Write a graph.

    Parameters
    ----------
    axes
        Free axes of each argument; by default the first one, which is the batch's.
    """
    # Ordinary tensors: those made in inference mode cannot be traced.
    arguments = tuple(argument.clone() for argument in arguments)
    axes = axes or [{0: free_axis("batch")}] * len(arguments)
    with warnings.catch_warnings():
        # Tensors share their free axes; torch warns that it keeps one name for each.
        warnings.filterwarnings("ignore", message="# The axis name")
        # torch's exporter calls deprecated functions of torch.
        warnings.filterwarnings("ignore", message=".isinstance.treespec", category=FutureWarning)
        torch.onnx.export(
            module.eval(), arguments, path, input_names=list(inputs), output_names=list(outputs),
            dynamic_shapes=tuple(axes), dynamo=True, external_data=False, verbose=False,
        )  # fmt: skip
    model = onnx.load(path)
    for initialiser in model.graph.initializer:
        rename(model.graph, initialiser.name, initialiser.name.removeprefix(_OWN_PREFIX))
        initialiser.name = initialiser.name.removeprefix(_OWN_PREFIX)
    store_in_bytes(model.graph)
    drop_traces(model.graph)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def free_axis(name: str) -> object:
    """Return an axis of a graph whose length is that of its input."""
    return torch.export.Dim(name, min=1, max=4096)


def drop_traces(graph: onnx.GraphProto) -> None:
    """Drop the exporter's stack traces: paths of this machine, and other bytes in every export."""
    parts = (graph.node, graph.initializer, graph.value_info, graph.input, graph.output)
    for part in (graph, *(one for of_kind in parts for one in of_kind)):
        del part.metadata_props[:]
        part.doc_string = ""


def open_graphs(folder: Path, files: Iterable[str]) -> dict[str, "InferenceSession"]:
    """Open the graphs of an artefact that exist, on one thread as in the service, by file."""
    keep_runtime_silent()
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return {
        file: onnxruntime.InferenceSession(folder / file, options)
        for file in files
        if (folder / file).exists()
    }


class Graphs:
    """An artefact's graphs, opened on one thread as in the service, to validate them.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    """

    def __init__(self, folder: Path) -> None:
        opened = open_graphs(folder, (PERCEPTION_FILE, ENCODER_FILE, ROLLOUT_FILE))
        self._perception = opened.get(PERCEPTION_FILE)
        self._encoder, self._rollout = opened[ENCODER_FILE], opened[ROLLOUT_FILE]
        self._read = [one.name for one in self._encoder.get_inputs()]

    def encode(self, frames: UInt8[np.ndarray, "B K 128 128 3"]) -> Step:
        """Return the first state and the outputs of step t = 0."""
        seen = {FRAMES_INPUT: frames}
        if self._perception is not None:
            seen = run_perception(self._perception.run, self._read, frames)
        return run_step(self._encoder, seen)

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        return run_steps(self._rollout, state, steps)

    def roll(self, frames: np.ndarray, horizon: int) -> dict[OutputName, np.ndarray]:
        """Forecast the steps 0..horizon-1 of frames: outputs [B, N, T, ...] by name."""
        return roll_out(self, frames, horizon)


def run_steps(session: "InferenceSession", state: Arrays, steps: int) -> Steps:
    """Return the state and the outputs of a rollout graph."""
    last = run_step(session, {**state, STEPS_INPUT: np.array(steps)})
    return Steps(last.state, last.outputs)


def run_step(session: "InferenceSession", inputs: Arrays) -> Step:
    """Return the state and the outputs of an encoder."""
    names = [one.name for one in session.get_outputs()]
    values = dict(zip(names, session.run(names, dict(inputs)), strict=True))
    return Step.split(values, [name for name in SPECS if name in values])


def present(observation: Observation) -> tuple[Tensor, ...]:
    """Return the outputs that a network has, in their order."""
    return tuple(observation.outputs().values())


def first_observation(predictor: Network, frames: Tensor) -> dict[OutputName, Tensor]:
    """Return the first observation by output name."""
    with torch.inference_mode():
        observation = predictor.observe_first(predictor.start(frames))
    return observation.outputs()
