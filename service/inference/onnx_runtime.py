"""ONNX Runtime: the only module that imports it."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from threading import Lock, Thread
from weakref import WeakValueDictionary

import numpy as np
from jaxtyping import UInt8
from loky import cpu_count

from rollcast.manifest import (
    ENCODER_FILE,
    FRAMES_INPUT,
    NEXT_PREFIX,
    OOD_FILE,
    PERCEPTION_FILE,
    ROLLOUT_FILE,
    STEPS_INPUT,
    Manifest,
)
from rollcast.ood import OodDetector
from rollcast.outputs import OutputName
from rollcast.perception_io import run_perception
from rollcast.rollout import Arrays, Outputs, Step, Steps
from service.inference.ball_predictor import BallPredictor
from service.inference.rollout import Predictor
from service.settings import CPU_PROVIDER, keep_runtime_silent

keep_runtime_silent()
import onnxruntime  # noqa: E402

PERCEPTION_CORES = min(2, cpu_count())
"""Maximum cores of the perception of one request (decision 0113)."""


class _SharedPerception:
    """A perception graph opened for one core and, on demand, for two: the outputs are equal.

    Parameters
    ----------
    path
        File of the graph.
    provider
        ONNX Runtime execution provider.
    """

    def __init__(self, path: Path, provider: str) -> None:
        # Not the file: it may be another one when it is opened again.
        self._graph = path.read_bytes()
        self._provider = provider
        self._one_core = self._two_cores = _session(self._graph, provider, reuse=True)
        self._again = Lock()

    def session(self, two_cores: bool) -> onnxruntime.InferenceSession:
        """Return that for as many cores as asked, as soon as it is open."""
        if (
            two_cores
            and self._graph
            and PERCEPTION_CORES > 1
            and self._provider == CPU_PROVIDER
            and self._again.acquire(blocking=False)
        ):
            Thread(target=self._open_two_cores, name="opens perception", daemon=True).start()
        return self._two_cores if two_cores else self._one_core

    def _open_two_cores(self) -> None:
        session = _session(self._graph, self._provider, PERCEPTION_CORES, reuse=True)
        self._two_cores, self._graph = session, b""


_perceptions: WeakValueDictionary[str, _SharedPerception] = WeakValueDictionary()
_opening = Lock()


class OnnxPredictor:
    """The graphs of an artefact. Safe to call from several threads at once.

    The perception graph, by far the largest, is shared by models with the same file.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    manifest
        Its manifest, which names the graphs' tensors.
    provider
        ONNX Runtime execution provider of the sessions.
    """

    def __init__(self, folder: Path, manifest: Manifest, provider: str = CPU_PROVIDER) -> None:
        self.manifest = manifest
        known = manifest.ood is not None
        self.ood_detector = OodDetector.read(folder / OOD_FILE) if known else None
        path, digest = folder / PERCEPTION_FILE, manifest.files.get(PERCEPTION_FILE)
        self._perception = None if digest is None else _shared_perception(path, digest, provider)
        # After perception it is small sums: optimising takes half the load and makes none faster.
        self._encoder = _session(folder / ENCODER_FILE, provider, optimised=digest is None)
        self._read = [one.name for one in self._encoder.get_inputs()]
        self._rollout = _session(folder / ROLLOUT_FILE, provider)
        self._state = [tensor.name for tensor in manifest.state]
        self._first = list(manifest.output_names)
        self._later = list(manifest.step_output_names)
        self._encoded = [*self._state, *self._first]
        self._stepped = [*(f"{NEXT_PREFIX}{name}" for name in self._state), *self._later]

    def encode(
        self, frames: UInt8[np.ndarray, "B K 128 128 3"], *, two_cores: bool = False
    ) -> Step:
        """Return the first state and the outputs of step t = 0; a second core may help."""
        if self._perception is None:
            seen = {FRAMES_INPUT: frames}
        else:
            seen = run_perception(self._perception.session(two_cores).run, self._read, frames)
        return Step(*self._split(self._encoder.run(self._encoded, seen), self._first))

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        asked = {**state, STEPS_INPUT: np.array(steps)}
        return Steps(*self._split(self._rollout.run(self._stepped, asked), self._later))

    def _split(
        self, values: list[np.ndarray], outputs: Sequence[OutputName]
    ) -> tuple[Arrays, Outputs]:
        split = len(self._state)
        return (
            dict(zip(self._state, values[:split], strict=True)),
            dict(zip(outputs, values[split:], strict=True)),
        )


def open_predictor(folder: Path, manifest: Manifest, provider: str = CPU_PROVIDER) -> Predictor:
    """Open the graphs of an artefact."""
    if manifest.max_objects is None:
        return OnnxPredictor(folder, manifest, provider)
    return BallPredictor(folder, manifest, partial(_session, provider=provider, reuse=True))


def check_provider(provider: str) -> None:
    """Check that the installed ONNX Runtime has an execution provider.

    Raises
    ------
    ValueError
        If it does not; the message names the available providers.
    """
    installed = onnxruntime.get_available_providers()
    if provider not in installed:
        raise ValueError(
            f"execution_provider: {provider} is not in the installed ONNX Runtime, which has "
            f"{', '.join(installed)}. GPUs need the package onnxruntime-gpu instead of onnxruntime"
        )


def _shared_perception(path: Path, digest: str, provider: str) -> _SharedPerception:
    """Open an perception, unless one with the same sha256 is open."""
    with _opening:
        shared = _perceptions.get(digest)
        if shared is None:
            shared = _perceptions[digest] = _SharedPerception(path, provider)
        return shared


def _session(
    graph: Path | bytes,
    provider: str,
    threads: int = 1,
    *,
    optimised: bool = True,
    reuse: bool = False,
) -> onnxruntime.InferenceSession:
    """Open a graph on threads that never spin between runs: cores belong to other requests.

    Raises
    ------
    RuntimeError
        If the execution provider does not start, for example without a GPU.
    """
    options = onnxruntime.SessionOptions()
    if not optimised:
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    # Thousands of sums with a few numbers each need not share memory: planning it takes half the
    # load of an encoder, and a step is a sixteenth faster without. The images of perception do.
    options.enable_mem_reuse = reuse
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3  # errors only: warnings concern the export
    # Threads that wait for each other hundreds of times a run spin meanwhile, and no longer.
    options.add_session_config_entry("session.intra_op.allow_spinning", str(int(threads > 1)))
    options.add_session_config_entry("session.force_spinning_stop", "1")
    # An arena for every session would keep the most that its largest batch ever needed.
    options.enable_cpu_mem_arena = False
    providers = list(dict.fromkeys((provider, CPU_PROVIDER)))
    session = onnxruntime.InferenceSession(graph, options, providers=providers)
    if provider not in session.get_providers():  # ONNX Runtime falls back without an error
        raise RuntimeError(f"{provider} does not start on this machine")
    return session
