"""Sequences for the networks: windows of stored simulations, rendered on the fly.

Training draws scenes, start times and symmetries for ever from a seeded generator; validation and
test take every scene once at its scenario's fixed start (paper, section 3.1, simulation details).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypedDict

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch.utils.data import IterableDataset

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.simulation.recording import TEST_START
from rollcast.simulation.rendering import Renderer
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.simulate import STORED_FRAMES, Recording

MAX_HORIZON = 40
"""Longest forecast that training or evaluation asks of a stored simulation (T_gen)."""


def generated_horizon(objects: int) -> int:
    """T_gen: the longest horizon that the paper's tables report for so many balls."""
    return MAX_HORIZON if objects == 1 else 30


LAST_START = STORED_FRAMES - FIRST_FORECAST_FRAME - MAX_HORIZON
"""Last frame of a stored simulation at which such a window can begin."""


class Window(NamedTuple):
    """One sequence: the seen frames and the truth of the steps t = 0..T-1 (128-px units, rad/s)."""

    frames: UInt8[np.ndarray, "seen 128 128 3"]
    positions: Float[np.ndarray, "objects steps 2"]
    angular_velocities: Float[np.ndarray, "objects steps 3"]


class Batch(TypedDict):
    """A batch of windows as tensors."""

    frames: torch.Tensor
    positions: torch.Tensor
    angular_velocities: torch.Tensor


@dataclass(frozen=True)
class Symmetry:
    """One of the square's eight symmetries: quarter turns, then perhaps a mirror in x.

    The camera's square, the walls and every scene distribution are invariant under them.
    """

    quarter_turns: int
    mirror: bool

    def apply(self, window: Window) -> Window:
        """Transform frames, positions and angular velocities alike.

        Angular velocity is a pseudo-vector: a mirror in x keeps its x and flips its y and z.
        """
        frames = np.rot90(window.frames, self.quarter_turns, axes=(1, 2))
        positions = window.positions - NETWORK_FRAME_SIZE / 2
        spin = window.angular_velocities
        for _ in range(self.quarter_turns):
            # Counter-clockwise as seen: world (x, y) -> (-y, x), so image (x, y) -> (y, -x).
            positions = np.stack([positions[..., 1], -positions[..., 0]], axis=-1)
            spin = np.stack([-spin[..., 1], spin[..., 0], spin[..., 2]], axis=-1)
        if self.mirror:
            frames = frames[:, :, ::-1]
            positions = positions * np.array([-1, 1])
            spin = spin * np.array([1, -1, -1])
        return Window(frames, positions + NETWORK_FRAME_SIZE / 2, spin)


class WindowMaker:
    """Cuts and renders windows; keeps the shaded background of every scene it has seen.

    Parameters
    ----------
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
    """

    def __init__(self, recordings: Sequence[Recording], final_step: int | None) -> None:
        self._recordings = recordings
        self._final_step = final_step
        self._renderers: dict[int, Renderer] = {}

    def window(self, index: int, start: int, horizon: int) -> Window:
        """Window of scene ``index`` whose first seen frame is ``start``."""
        scene, trajectory = self._recordings[index].scene, self._recordings[index].trajectory
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        if index not in self._renderers:
            self._renderers[index] = Renderer(scene, camera)
        frames = self._renderers[index].render(trajectory.window(start, OBSERVED_FRAMES))
        if self._final_step is not None:
            last = trajectory.window(start + FIRST_FORECAST_FRAME + self._final_step, 1)
            frames = np.concatenate([frames, self._renderers[index].render(last)])
        steps = trajectory.window(start + FIRST_FORECAST_FRAME, horizon)
        return Window(
            frames,
            camera.project(steps.positions_m).swapaxes(0, 1),
            steps.angular_velocities_rad_s.swapaxes(0, 1),
        )


class TrainingStream(IterableDataset[Batch]):
    """Endless batches. Batch k depends on the seed and on k alone, so training can resume anywhere.

    Parameters
    ----------
    groups
        Recordings by source, with the share of the batch that each gets.
    latest_starts
        For every group, the last frame at which a window may begin.
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
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
    ) -> None:
        if max(latest_starts) > LAST_START:
            raise ValueError(
                f"latest_start is {max(latest_starts)}; at most {LAST_START} is stored"
            )
        self._makers = [WindowMaker(group, final_step) for group in groups]
        self._sizes = [len(group) for group in groups]
        self._shares = np.asarray(shares) / np.sum(shares)
        self._latest_starts = latest_starts
        self._batch_size = batch_size
        self._seed = seed
        self._first_batch = first_batch

    def __iter__(self) -> Iterator[Batch]:
        """Batches from ``first_batch`` on; several loader processes share them out in turn."""
        worker = torch.utils.data.get_worker_info()
        first, stride = (0, 1) if worker is None else (worker.id, worker.num_workers)
        number = self._first_batch + first
        while True:
            yield self._batch(np.random.default_rng([self._seed, number]))
            number += stride

    def _batch(self, generator: np.random.Generator) -> Batch:
        return collate([self._draw(generator) for _ in range(self._batch_size)])

    def _draw(self, generator: np.random.Generator) -> Window:
        group = int(generator.choice(len(self._makers), p=self._shares))
        index = int(generator.integers(self._sizes[group]))
        start = int(generator.integers(self._latest_starts[group] + 1))
        symmetry = Symmetry(int(generator.integers(4)), bool(generator.integers(2)))
        return symmetry.apply(self._makers[group].window(index, start, MAX_HORIZON))


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
    return Batch(
        frames=torch.from_numpy(np.stack([window.frames for window in windows])),
        positions=torch.from_numpy(np.stack([w.positions for w in windows]).astype(np.float32)),
        angular_velocities=torch.from_numpy(
            np.stack([w.angular_velocities for w in windows]).astype(np.float32)
        ),
    )
