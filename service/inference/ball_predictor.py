"""Models for any number of balls: found in frames of any size, then rolled out.

Perception belongs to a request alone, because every request has other balls in frames of another
size. Rollouts of as many balls each are stepped together, as those of other models.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float, Float32, UInt8

from rollcast.ball_finding import Arrays as Said
from rollcast.ball_finding import (
    Balls,
    Sightings,
    by_motion,
    find_balls,
    moving_balls,
    sight_balls,
)
from rollcast.manifest import (
    BALL_INPUTS,
    DETECTOR_FILE,
    DETECTOR_OUTPUTS,
    ENCODER_FILE,
    FRAMES_INPUT,
    NEXT_PREFIX,
    PATCHES_INPUT,
    REFINER_FILE,
    ROLLOUT_FILE,
    SCENE_INPUTS,
    SPACING_INPUT,
    STEPS_INPUT,
    Manifest,
)
from rollcast.ood import OodDetector
from rollcast.rollout import Arrays, Outputs, Step, Steps
from rollcast.trajectory import OBSERVED_FRAMES
from service.errors import InvalidValueError
from service.inference.rollout import Predictor


class GraphSession(Protocol):
    """A graph that can be run."""

    def run(self, outputs: Sequence[str], inputs: Mapping[str, Any], /) -> list[Any]:
        """Return the named outputs."""
        ...


@dataclass(frozen=True)
class FoundBalls:
    """The balls of one request, with the inputs of its rollout."""

    balls: Balls
    said: Said
    """Outputs of the detector for the whole frames."""
    spacing: float = 1.0
    """Time between two of the frames, in steps of the rollout."""

    @property
    def packed(self) -> Float32[np.ndarray, "1 numbers"]:
        """Inputs of the encoder side by side, so that equal requests can be stacked."""
        of_balls = [np.ravel(getattr(self.balls, name)) for name in BALL_INPUTS]
        of_scene = [np.ravel(self.said[name]) for name in SCENE_INPUTS]
        return np.concatenate([*of_balls, *of_scene, [self.spacing]])[None].astype(np.float32)


class BallPredictor:
    """The graphs of an artefact for any number of balls. Safe to call from several threads.

    Parameters
    ----------
    folder
        ``models/NAME/VERSION``.
    manifest
        Its manifest.
    open_session
        Opens a graph.
    """

    def __init__(
        self, folder: Path, manifest: Manifest, open_session: Callable[[Path], GraphSession]
    ) -> None:
        self.manifest = manifest
        self.ood_detector: OodDetector | None = None
        self._detector = open_session(folder / DETECTOR_FILE)
        self._refiner = open_session(folder / REFINER_FILE)
        self._encoder = open_session(folder / ENCODER_FILE)
        self._rollout_graph = open_session(folder / ROLLOUT_FILE)
        self._state = [tensor.name for tensor in manifest.state]
        self._outputs = list(manifest.output_names)
        self.rollout = cache(self._rollout)

    def find(
        self,
        frames: UInt8[np.ndarray, "4 height width 3"],
        prompts: Float[np.ndarray, "balls 2"] | None = None,
        radii: Float[np.ndarray, " balls"] | None = None,
        objects: int | None = None,
        spacing: float = 1.0,
    ) -> FoundBalls:
        """Find the balls of one request.

        Parameters
        ----------
        prompts
            Points of the letterboxed square that say which balls are meant.
        radii
            Of the prompts, NaN where it is not known.
        objects
            Number of balls without prompts; None selects the moving balls, at least one.
        spacing
            Time between two frames, in steps of the rollout.

        Raises
        ------
        InvalidValueError
            When fewer balls are found than are wanted.
        """
        balls, said = find_balls(self._detect, self._refine, frames, prompts, radii)
        if prompts is None:
            balls = balls.taken(_wanted(balls, objects, self.manifest.max_objects or 1))
        return FoundBalls(balls, said, spacing)

    def sight(
        self,
        frames: UInt8[np.ndarray, "4 height width 3"],
        least_score: float,
        *,
        refine_still: bool,
    ) -> Sightings:
        """Find all balls, moving or not (:func:`rollcast.ball_finding.sight_balls`)."""
        return sight_balls(
            self._detect, self._refine, frames, least_score, refine_still=refine_still
        )

    def encode(
        self,
        frames: UInt8[np.ndarray, "B K 128 128 3"],
        *,
        two_cores: bool = False,  # noqa: ARG002
    ) -> Step:
        """Return the initial state of the manifest's number of balls, by confidence of motion."""
        objects = self.manifest.objects
        found = [self.find(each[:OBSERVED_FRAMES], objects=objects) for each in frames]
        return self.rollout(objects).encode(np.concatenate([one.packed for one in found]))

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        names = [*(f"{NEXT_PREFIX}{name}" for name in self._state), *self._outputs]
        asked = {**state, STEPS_INPUT: np.array(steps)}
        return Steps(*self._split(self._rollout_graph.run(names, asked)))

    def begin(self, seen: Arrays) -> Step:
        """Return the first state of balls that were found."""
        return Step(*self._split(self._encoder.run([*self._state, *self._outputs], seen)))

    def _rollout(self, objects: int) -> "BallRollout":
        return BallRollout(self, objects)

    def _detect(self, frames: np.ndarray) -> Said:
        said = self._detector.run(DETECTOR_OUTPUTS, {FRAMES_INPUT: frames})
        return dict(zip(DETECTOR_OUTPUTS, said, strict=True))

    def _refine(self, patches: np.ndarray, wanted: Sequence[str]) -> Said:
        return dict(zip(wanted, self._refiner.run(wanted, {PATCHES_INPUT: patches}), strict=True))

    def _split(self, values: Sequence[np.ndarray]) -> tuple[Arrays, Outputs]:
        split = len(self._state)
        return (
            dict(zip(self._state, values[:split], strict=True)),
            dict(zip(self._outputs, values[split:], strict=True)),
        )


class BallRollout(Predictor):
    """A model for any number of balls, for requests with as many balls each.

    Parameters
    ----------
    model
        The model.
    objects
        Balls of a request.
    """

    def __init__(self, model: BallPredictor, objects: int) -> None:
        self.manifest = model.manifest
        self.ood_detector = model.ood_detector
        self._model = model
        self._objects = objects

    def encode(self, frames: np.ndarray, *, two_cores: bool = False) -> Step:  # noqa: ARG002
        """Return the first state of packed balls (:attr:`FoundBalls.packed`) of B requests."""
        count = self._objects
        shapes = {
            "places": (count, OBSERVED_FRAMES, 2),
            "radii": (count,),
            "log_sigmas": (count, 2),
            "features": (count, -1),
            "ground": self.manifest.state[0].shape,
            "scene": (2,),
            SPACING_INPUT: (),
        }
        known = {name: int(np.prod(shape)) for name, shape in shapes.items() if -1 not in shape}
        known["features"] = frames.shape[1] - sum(known.values())
        names = (*BALL_INPUTS, *SCENE_INPUTS, SPACING_INPUT)
        ends = np.cumsum([known[name] for name in names])
        parts = np.split(frames, ends[:-1], axis=1)
        return self._model.begin(
            {
                name: part.reshape(len(frames), *shapes[name])
                for name, part in zip(names, parts, strict=True)
            }
        )

    def advance(self, state: Arrays, steps: int) -> Steps:
        """Return the state after some steps and their outputs."""
        return self._model.advance(state, steps)


def _wanted(balls: Balls, objects: int | None, most: int) -> np.ndarray:
    """Return the indices of the balls of a request without prompts, moving balls first."""
    if objects is None:
        return moving_balls(balls, most)
    order = by_motion(balls)
    if len(order) < objects:
        expected = f"at most {len(order)}, the balls that are found in the frames"
        raise InvalidValueError.at("num_objects", objects, expected)
    return order[:objects]
