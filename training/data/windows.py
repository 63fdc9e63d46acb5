"""Sequences for the networks: windows of stored simulations, rendered on the fly.

Training draws scenes, start times and symmetries for ever from a seeded generator; validation and
test take every scene once at its scenario's fixed start (paper, section 3.1, simulation details).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, NotRequired, Protocol, TypedDict

import numpy as np
import torch
from jaxtyping import Float, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.simulation.recording import TEST_START
from rollcast.simulation.rendering import Renderer
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.common.distributed import Share
from training.data.scene_cache import SceneCache
from training.data.seeded_stream import SeededStream
from training.data.shards import STORED_FRAMES, Recording
from training.networks.perception import scene_constants_of
from training.networks.recurrent import InitialState

MAX_HORIZON = 40
"""Longest forecast of training and evaluation on stored simulations (T_gen)."""


def generated_horizon(objects: int) -> int:
    """T_gen: the longest horizon that the paper's tables report for so many balls."""
    return MAX_HORIZON if objects == 1 else 30


def compared_horizon(objects: int) -> int:
    """T_train of the paper: the horizon at which models are compared, whatever theirs is."""
    return generated_horizon(objects) // 2


FRAME_SHAPE = (NETWORK_FRAME_SIZE, NETWORK_FRAME_SIZE, 3)

LAST_START = STORED_FRAMES - FIRST_FORECAST_FRAME - MAX_HORIZON
"""Last frame of a stored simulation at which such a window can begin."""


class SceneTargets(NamedTuple):
    """Additional targets of networks with an explicit state.

    Halves of the frame in image axes (x right, y down, z towards the camera).
    """

    centres: Float[np.ndarray, "objects frames 3"]
    """Ball centres from the first observed frame to the last step."""
    ground: Float[np.ndarray, "3 cells cells"]
    """Map of :func:`training.data.rest_height_map.resting_ground`."""
    scene_constants: Float[np.ndarray, "2"]
    """Constants of :func:`training.networks.perception.scene_constants_of`."""


class Guidance(NamedTuple):
    """Additional data of windows of random appearance (:mod:`training.data.appearance_mixture`)."""

    prompts: Float[np.ndarray, "objects 2"]
    """Prompts near the balls in the last observed frame; NaN without a prompt."""
    shake: Float[np.ndarray, "seen 2"]
    """Shift of the picture in every seen frame against the last one, pixels."""
    radii: Float[np.ndarray, " objects"]
    """Radii of the balls in the frames, pixels."""


class Window(NamedTuple):
    """One sequence: the seen frames and the truth of the steps t = 0..T-1 (128-px units, rad/s)."""

    frames: UInt8[np.ndarray, "seen 128 128 3"]
    """Frames; empty for windows without frames."""
    positions: Float[np.ndarray, "objects steps 2"]
    angular_velocities: Float[np.ndarray, "objects steps 3"]
    scene_targets: SceneTargets | None = None
    guidance: Guidance | None = None


class Batch(TypedDict):
    """A batch of windows as tensors."""

    frames: torch.Tensor
    positions: torch.Tensor
    angular_velocities: torch.Tensor
    scene_targets: NotRequired[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]
    """The fields of :class:`SceneTargets`."""
    guidance: NotRequired[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]
    """The fields of :class:`Guidance`."""
    from_true_states: NotRequired["Batch"]
    """More windows without frames."""
    initial_state: NotRequired[InitialState]
    """Cached initial states in place of frames."""


@dataclass(frozen=True)
class Symmetry:
    """One of the square's eight symmetries: quarter turns, then perhaps a mirror in x.

    The camera's square, the walls and every scene distribution are invariant under them.
    """

    quarter_turns: int
    mirror: bool

    def apply(self, window: Window) -> Window:
        """Transform frames, positions, angular velocities and scene targets alike.

        Angular velocity is a pseudo-vector: a mirror in x keeps its x and flips its y and z.
        """
        frames = np.rot90(window.frames, self.quarter_turns, axes=(1, 2))
        spin = window.angular_velocities
        for _ in range(self.quarter_turns):
            # Counter-clockwise as seen: world (x, y) -> (-y, x), so image (x, y) -> (y, -x).
            spin = np.stack([-spin[..., 1], spin[..., 0], spin[..., 2]], axis=-1)
        if self.mirror:
            frames = frames[:, :, ::-1]
            spin = spin * np.array([1, -1, -1])
        middle = NETWORK_FRAME_SIZE / 2
        positions = self._turned(window.positions - middle) + middle
        scene_targets = (
            None
            if window.scene_targets is None
            else self._apply_to_scene_targets(window.scene_targets)
        )
        guidance = window.guidance
        if guidance is not None:
            prompts = self._turned(guidance.prompts - middle) + middle
            guidance = Guidance(prompts, self._turned(guidance.shake), guidance.radii)
        return Window(frames, positions, spin, scene_targets, guidance)

    def _turned(self, vectors: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Transform vectors in image axes."""
        for _ in range(self.quarter_turns):
            vectors = np.stack([vectors[..., 1], -vectors[..., 0]], axis=-1)
        return vectors * np.array([-1, 1]) if self.mirror else vectors

    def _apply_to_scene_targets(self, scene_targets: SceneTargets) -> SceneTargets:
        centres, ground = (
            scene_targets.centres,
            np.rot90(scene_targets.ground, self.quarter_turns, axes=(1, 2)),
        )
        for _ in range(self.quarter_turns):
            centres = np.stack([centres[..., 1], -centres[..., 0], centres[..., 2]], axis=-1)
            ground = np.stack([ground[1], -ground[0], ground[2]])
        if self.mirror:
            centres = centres * np.array([-1, 1, 1])
            ground = ground[:, :, ::-1] * np.array([-1, 1, 1])[:, None, None]
        return SceneTargets(centres, ground, scene_targets.scene_constants)


class WindowMaker:
    """Cuts and renders windows; keeps the shaded background of every scene it has seen.

    Parameters
    ----------
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
    scene_cache
        Of the recordings; without it every scene is shaded when it is first seen.
    scene_targets
        Whether windows have scene targets, which needs a scene cache.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        final_step: int | None,
        scene_cache: SceneCache | None = None,
        *,
        scene_targets: bool = False,
    ) -> None:
        self._recordings = recordings
        self._final_step = final_step
        self._scene_cache = scene_cache
        self._grounds = scene_cache.ground if scene_targets and scene_cache is not None else None
        self._renderers: dict[int, Renderer] = {}

    def window(self, index: int, start: int, horizon: int, *, seen: bool = True) -> Window:
        """Window of scene ``index`` whose first observed frame is ``start``."""
        scene, trajectory = self._recordings[index].scene, self._recordings[index].trajectory
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        steps = trajectory.window(start + FIRST_FORECAST_FRAME, horizon)
        return Window(
            self._frames(index, start) if seen else np.empty((0, *FRAME_SHAPE), np.uint8),
            camera.project(steps.positions_m).swapaxes(0, 1),
            steps.angular_velocities_rad_s.swapaxes(0, 1),
            self._scene_targets(index, start, horizon),
        )

    def _frames(self, index: int, start: int) -> UInt8[np.ndarray, "seen 128 128 3"]:
        trajectory = self._recordings[index].trajectory
        frames = self.renderer(index).render(trajectory.window(start, OBSERVED_FRAMES))
        if self._final_step is None:
            return frames
        last = trajectory.window(start + FIRST_FORECAST_FRAME + self._final_step, 1)
        return np.concatenate([frames, self.renderer(index).render(last)])

    def recording(self, index: int) -> Recording:
        """Return a scene with its trajectory."""
        return self._recordings[index]

    def renderer(self, index: int) -> Renderer:
        """Return the renderer of a scene."""
        if index not in self._renderers:
            scene = self._recordings[index].scene
            camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
            empty = None if self._scene_cache is None else self._scene_cache.empty[index]
            self._renderers[index] = Renderer(scene, camera, empty)
        return self._renderers[index]

    def _scene_targets(self, index: int, start: int, horizon: int) -> SceneTargets | None:
        if self._grounds is None:
            return None
        scene, trajectory = self._recordings[index].scene, self._recordings[index].trajectory
        half_width = camera_for(scene.scenario, NETWORK_FRAME_SIZE).half_width_m
        centres = trajectory.window(start, FIRST_FORECAST_FRAME + horizon).positions_m
        centres = centres.swapaxes(0, 1) * (np.array([1, -1, 1]) / half_width)
        return SceneTargets(
            centres, self._grounds[index], scene_constants_of(half_width, scene.radius_m)
        )


class WindowAppearance(NamedTuple):
    """Appearance of one training window."""

    kind: Literal["paper", "restyled", "planar"]
    """Appearance: the paper's, another one of its scenes, or a planar scene."""
    prompted: bool
    seed: int


class Mixture(Protocol):
    """Mixture of appearances of training windows."""

    def draw(self, generator: np.random.Generator) -> WindowAppearance:
        """Draw the appearance of a window."""
        ...

    def window(
        self, appearance: WindowAppearance, maker: WindowMaker, index: int, start: int, horizon: int
    ) -> Window:
        """Make the window, with guidance."""
        ...


class _Drawn(NamedTuple):
    """Which window is a row of a batch."""

    group: int
    scene: int
    start: int
    symmetry: Symmetry
    appearance: WindowAppearance | None


class TrainingStream(SeededStream[Batch]):
    """Endless batches of windows of stored simulations.

    Parameters
    ----------
    groups
        Recordings by source, with the share of the batch that each gets.
    latest_starts
        For every group, the last frame at which a window may begin.
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
    scene_caches
        One for every group.
    true_state_windows
        Windows without frames beside every batch.
    seen
        Whether the windows have frames.
    scene_targets
        Whether they have scene targets.
    share
        The rows of every batch that are made.
    mixture
        Appearance of the windows; None for the paper's only.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[Recording]],
        shares: Sequence[float],
        latest_starts: Sequence[int],
        final_step: int | None,
        batch_size: int,
        seed: int,
        first_batch: int,
        scene_caches: Sequence[SceneCache],
        true_state_windows: int = 0,
        *,
        seen: bool = True,
        scene_targets: bool = False,
        share: Share | None = None,
        mixture: Mixture | None = None,
    ) -> None:
        if max(latest_starts) > LAST_START:
            raise ValueError(
                f"latest_start is {max(latest_starts)}; at most {LAST_START} is stored"
            )
        super().__init__(seed, first_batch)
        self._makers = [
            WindowMaker(group, final_step, scene_cache, scene_targets=scene_targets)
            for group, scene_cache in zip(groups, scene_caches, strict=True)
        ]
        self._true_state_windows = true_state_windows
        self._seen = seen
        self._sizes = [len(group) for group in groups]
        self._shares = np.asarray(shares) / np.sum(shares)
        self._latest_starts = latest_starts
        self._batch_size = batch_size
        self._share = share or Share()
        self._mixture = mixture

    def _batch(self, generator: np.random.Generator, number: int) -> Batch:  # noqa: ARG002 - the base's
        batch = collate(self._windows(generator, self._batch_size, seen=self._seen))
        if self._true_state_windows:
            batch["from_true_states"] = collate(
                self._windows(generator, self._true_state_windows, seen=False)
            )
        return batch

    def _windows(self, generator: np.random.Generator, rows: int, *, seen: bool) -> list[Window]:
        # Every process draws all rows, so the batch is the same for any number of processes.
        drawn = [self._draw(generator) for _ in range(rows)]
        return [self._window(drawn[row], seen=seen) for row in self._share.of(rows)]

    def _draw(self, generator: np.random.Generator) -> _Drawn:
        group = int(generator.choice(len(self._makers), p=self._shares))
        return _Drawn(
            group,
            scene=int(generator.integers(self._sizes[group])),
            start=int(generator.integers(self._latest_starts[group] + 1)),
            symmetry=Symmetry(int(generator.integers(4)), bool(generator.integers(2))),
            appearance=None if self._mixture is None else self._mixture.draw(generator),
        )

    def _window(self, drawn: _Drawn, *, seen: bool) -> Window:
        maker, place = self._makers[drawn.group], (drawn.scene, drawn.start, MAX_HORIZON)
        if drawn.appearance is None or self._mixture is None:
            window = maker.window(*place, seen=seen)
        else:
            window = self._mixture.window(drawn.appearance, maker, *place)
        return drawn.symmetry.apply(window)


def fixed_windows(
    recordings: Sequence[Recording], horizon: int, final_step: int | None
) -> list[Window]:
    """Every recording once, seen from its scenario's fixed test start."""
    maker = WindowMaker(recordings, final_step)
    return [
        maker.window(index, TEST_START[recording.scene.scenario], horizon)
        for index, recording in enumerate(recordings)
    ]


def collate(windows: Sequence[Window]) -> Batch:
    """Stack windows into a batch of tensors."""
    batch = Batch(
        frames=torch.from_numpy(np.stack([window.frames for window in windows])),
        positions=_float32([window.positions for window in windows]),
        angular_velocities=_float32([window.angular_velocities for window in windows]),
    )
    scene_targets = [window.scene_targets for window in windows if window.scene_targets is not None]
    if scene_targets:
        centres, grounds, scales = zip(*scene_targets, strict=True)
        batch["scene_targets"] = (_float32(centres), _float32(grounds), _float32(scales))
    guided = [window.guidance for window in windows if window.guidance is not None]
    if guided:
        prompts, shakes, radii = zip(*guided, strict=True)
        batch["guidance"] = (_float32(prompts), _float32(shakes), _float32(radii))
    return batch


def _float32(arrays: Sequence[np.ndarray]) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays).astype(np.float32))
