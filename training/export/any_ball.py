"""The network for any number of balls as graphs whose number of balls is a free axis.

Four graphs: the detector reads whole frames, the refiner patches (M of them, of all balls),
the encoder turns their outputs into the initial state, and the step advances it. Between them
:func:`rollcast.ball_finding.find_balls` cuts the patches out of the full-size frames.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rollcast.ball_finding import Arrays, Balls
from rollcast.manifest import (
    BALL_INPUTS,
    DETECTOR_FILE,
    DETECTOR_OUTPUTS,
    ENCODER_FILE,
    FRAMES_INPUT,
    NEXT_PREFIX,
    PATCHES_INPUT,
    REFINER_FILE,
    REFINER_OUTPUTS,
    ROLLOUT_FILE,
    SCENE_INPUTS,
    SPACING_INPUT,
)
from rollcast.outputs import OutputName
from rollcast.patches import PATCH_SIZE
from rollcast.rollout import joined
from rollcast.trajectory import OBSERVED_FRAMES
from training.export.onnx_graphs import (
    free_axis,
    open_graphs,
    present,
    run_step,
    run_steps,
    write_graph,
    write_rollout_graph,
)
from training.networks.any_ball import AnyBallNet, seen_balls
from training.networks.ball_detector import peaks
from training.networks.perception import FEATURES
from training.networks.recurrent import State

STATE_NAMES = State._fields
OUTPUTS: tuple[OutputName, ...] = ("positions", "covariances", "angular_velocities")


class DetectorGraph(torch.nn.Module):
    """Frames to DETECTOR_OUTPUTS, as positional tensors."""

    def __init__(self, network: AnyBallNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, frames: Tensor) -> tuple[Tensor, ...]:
        """Look at frames uint8 [B, 4, 128, 128, 3]."""
        maps = self.network.perception.detector.maps(frames)
        votes = torch.cat(
            [
                maps.places.flatten(1, 2), maps.log_radius[:, None],
                maps.heat[:, None].sigmoid(), maps.moving[:, None].sigmoid(),
            ],
            dim=1,
        )  # fmt: skip
        return *peaks(maps), votes, maps.ground, maps.scene


class RefinerGraph(torch.nn.Module):
    """Patches to REFINER_OUTPUTS, as positional tensors."""

    def __init__(self, network: AnyBallNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, patches: Tensor) -> tuple[Tensor, ...]:
        """Read patches [M, 4, 3, P, P]."""
        said = self.network.perception.refiner(patches)
        return tuple(getattr(said, name) for name in REFINER_OUTPUTS)


class BallEncoderGraph(torch.nn.Module):
    """Outputs of the refiner for N balls to the initial state and first observation."""

    def __init__(self, network: AnyBallNet) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        places: Tensor,
        radii: Tensor,
        log_sigmas: Tensor,
        features: Tensor,
        ground: Tensor,
        scene: Tensor,
        spacing: Tensor,
    ) -> tuple[Tensor, ...]:
        """Begin."""
        seen = seen_balls(places, radii, radii[..., None], log_sigmas, features)
        state, _ = self.network.begin(seen, ground, scene, spacing)
        return *state, *present(self.network.observe(state))


class BallStepGraph(torch.nn.Module):
    """A state of N balls to the next one and its observation, as positional tensors."""

    def __init__(self, network: AnyBallNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, s: Tensor, p: Tensor) -> tuple[Tensor, ...]:
        """Move a frame on."""
        state = self.network.advance(State(s, p))
        return *state, *present(self.network.observe(state))


def write_ball_graphs(network: AnyBallNet, folder: Path) -> None:
    """Write the graphs of a network into an artefact's folder."""
    network = network.eval()
    folder.mkdir(parents=True, exist_ok=True)
    batch = free_axis("batch")
    balls = free_axis("balls")
    frames = torch.zeros(2, OBSERVED_FRAMES, 128, 128, 3, dtype=torch.uint8)
    write_graph(
        DetectorGraph(network), (frames,), [FRAMES_INPUT], DETECTOR_OUTPUTS,
        folder / DETECTOR_FILE, ({0: batch},),
    )  # fmt: skip
    patches = torch.zeros(3, OBSERVED_FRAMES, 3, PATCH_SIZE, PATCH_SIZE)
    write_graph(
        RefinerGraph(network), (patches,), [PATCHES_INPUT], REFINER_OUTPUTS,
        folder / REFINER_FILE, ({0: balls},),
    )  # fmt: skip
    both = {0: batch, 1: balls}
    begun = (
        torch.rand(2, 3, OBSERVED_FRAMES, 2), torch.rand(2, 3) + 0.1, torch.zeros(2, 3, 2),
        torch.zeros(2, 3, FEATURES), torch.zeros(2, 3, 32, 32), torch.zeros(2, 2), torch.ones(2),
    )  # fmt: skip
    encoded = [*STATE_NAMES, *OUTPUTS]
    write_graph(
        BallEncoderGraph(network), begun, [*BALL_INPUTS, *SCENE_INPUTS, SPACING_INPUT], encoded,
        folder / ENCODER_FILE,
        (both, both, both, both, {0: batch}, {0: batch}, {0: batch}),
    )  # fmt: skip
    with torch.inference_mode():
        state = BallEncoderGraph(network)(*begun)[: len(STATE_NAMES)]
    stepped = [*(NEXT_PREFIX + name for name in STATE_NAMES), *OUTPUTS]
    axes = ({0: batch}, both)
    write_rollout_graph(BallStepGraph(network), state, stepped, folder / ROLLOUT_FILE, axes)


class BallGraphs:
    """An artefact's graphs on one thread, as the service opens them: to prove and to measure.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    """

    def __init__(self, folder: Path) -> None:
        files = (DETECTOR_FILE, REFINER_FILE, ENCODER_FILE, ROLLOUT_FILE)
        self._detector, self._refiner, self._encoder, self._rollout = open_graphs(
            folder, files
        ).values()

    def detect(self, frames: np.ndarray) -> Arrays:
        """Run the detector."""
        said = self._detector.run(list(DETECTOR_OUTPUTS), {FRAMES_INPUT: frames})
        return dict(zip(DETECTOR_OUTPUTS, said, strict=True))

    def refine(self, patches: np.ndarray, wanted: Sequence[str] = REFINER_OUTPUTS) -> Arrays:
        """Run the refiner."""
        said = self._refiner.run(list(wanted), {PATCHES_INPUT: patches})
        return dict(zip(wanted, said, strict=True))

    def roll(
        self, balls: Balls, said: Arrays, horizon: int, spacing: float = 1.0
    ) -> dict[OutputName, np.ndarray]:
        """Forecast the steps 0..horizon-1 of balls: outputs [N, T, ...] by name.

        Parameters
        ----------
        spacing
            Time between two seen frames, in steps.
        """
        seen = {name: getattr(balls, name)[None].astype(np.float32) for name in BALL_INPUTS}
        seen |= {name: said[name] for name in SCENE_INPUTS}
        seen[SPACING_INPUT] = np.array([spacing], np.float32)
        first = run_step(self._encoder, seen)
        later = run_steps(self._rollout, first.state, horizon - 1)
        rolled = joined([first.as_steps, later.outputs])
        return {name: rolled[name][0] for name in OUTPUTS}
