"""True states, for networks that see no frames (paper, section 5.1: NPE and IFS).

Lengths are halves of the frame, x to the right and y down from its centre, so velocities are
halves of the frame a frame; angular velocities are those of the world's axes in multiples of
:data:`training.networks.recurrent.ANGULAR_VELOCITY_UNIT`.
"""

from collections.abc import Iterator, Sequence
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Scene
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import FIRST_FORECAST_FRAME
from training.data.shards import Recording
from training.data.windows import FRAME_SHAPE, Symmetry, Window
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT

HALF_FRAME_PX = NETWORK_FRAME_SIZE / 2


class States(NamedTuple):
    """Consecutive true states of several sequences, from t = -3 on."""

    positions: Tensor
    """Positions [B, N, T, 2]."""
    velocities: Tensor
    """Displacements since the previous frame [B, N, T, 2]."""
    spins: Tensor
    """Angular velocities [B, N, T, 3]."""
    bowl: Tensor
    """Axis ratio, and cosine and sine of twice its axis' angle [B, 3]; zeros on heightfields."""

    def until(self, frames: int) -> "States":
        """Return the first frames of every sequence."""
        return self._frames(slice(frames))

    def last(self, frames: int) -> "States":
        """Return the last frames of every sequence."""
        return self._frames(slice(-frames, None))

    def _frames(self, chosen: slice) -> "States":
        return States(
            self.positions[:, :, chosen],
            self.velocities[:, :, chosen],
            self.spins[:, :, chosen],
            self.bowl,
        )

    def per_ball(self, *, angular_velocity: bool) -> Tensor:
        """Return position, velocity, perhaps spin, and the bowl of every ball [B, N, T, C]."""
        bowl = self.bowl[:, None, None].expand(*self.positions.shape[:3], -1)
        moving = [self.positions, self.velocities / VELOCITY_UNIT]
        return torch.cat([*moving, *([self.spins] if angular_velocity else []), bowl], dim=-1)


VELOCITY_UNIT = 0.1
"""Halves of the frame a frame: about as fast as balls are, so that networks see numbers near 1."""


class StateSet:
    """Every scene of some recordings, which have equally many balls and frames.

    Batches are drawn from tables of all frames, one for each way in which scenes may lie: a batch
    is a single look-up.
    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        scenario = recordings[0].scene.scenario
        camera = camera_for(scenario, NETWORK_FRAME_SIZE)
        centres = np.stack([recording.trajectory.positions_m for recording in recordings])
        spins = np.stack([one.trajectory.angular_velocities_rad_s for one in recordings])
        positions = camera.project(centres) / HALF_FRAME_PX - 1
        self._positions = torch.from_numpy(positions.astype(np.float32)).transpose(1, 2)
        self._spins = torch.from_numpy(
            (spins / ANGULAR_VELOCITY_UNIT).astype(np.float32)
        ).transpose(1, 2)
        self._bowls = torch.tensor([_bowl(recording.scene) for recording in recordings])
        self._test_start = TEST_START[scenario]

    def fixed(self, horizon: int) -> States:
        """Return every scene from the test start up to step ``horizon - 1``."""
        start, end = self._test_start, self._test_start + FIRST_FORECAST_FRAME + horizon
        positions = self._positions[:, :, start - 1 : end]
        return States(
            positions[:, :, 1:],
            positions[:, :, 1:] - positions[:, :, :-1],
            self._spins[:, :, start:end],
            self._bowls,
        )

    def drawn(
        self, frames: int, latest_start: int, batch_size: int, seed: int, first_batch: int
    ) -> Iterator[States]:
        """Draw batches for ever, turned and mirrored; batch k depends on the seed and k alone."""
        number = first_batch
        count, recorded = len(self._bowls), self._positions.shape[2]
        states, bowls = self._all_symmetries
        within = torch.arange(-1, frames)
        while True:
            generator = np.random.default_rng([seed, number])
            scenes = torch.from_numpy(generator.integers(count, size=batch_size))
            starts = torch.from_numpy(generator.integers(1, latest_start + 1, size=batch_size))
            turns = torch.from_numpy(generator.integers(4, size=batch_size))
            mirrored = torch.from_numpy(generator.integers(2, size=batch_size))
            chosen = (turns + 4 * mirrored) * count + scenes
            rows = (chosen * recorded + starts)[:, None] + within
            found = states.index_select(0, rows.flatten()).unflatten(0, rows.shape).transpose(1, 2)
            positions = found[..., :2]
            yield States(
                positions[:, :, 1:],
                positions[:, :, 1:] - positions[:, :, :-1],
                found[:, :, 1:, 2:],
                bowls[chosen],
            )
            number += 1

    @cached_property
    def _all_symmetries(self) -> tuple[Tensor, Tensor]:
        """Positions and spins of every frame [8 * S * F, N, 5], and bowls [8 * S, 3]."""
        usual = States(self._positions, torch.zeros_like(self._positions), self._spins, self._bowls)
        ones = torch.ones(len(self._bowls), dtype=torch.int64)
        moved = [
            turned(usual, turns * ones, (mirrored * ones).bool())
            for mirrored in range(2)
            for turns in range(4)
        ]
        frames = [torch.cat([one.positions, one.spins], -1).transpose(1, 2) for one in moved]
        return torch.cat(frames).flatten(0, 1), torch.cat([one.bowl for one in moved])


def turned(states: States, quarter_turns: Tensor, mirrored: Tensor) -> States:
    """Turn sequences counter-clockwise as seen, then mirror some in x.

    Each by the :class:`training.data.windows.Symmetry` that frames are turned by.
    """
    of_images, of_worlds = _symmetries()
    chosen = quarter_turns + 4 * mirrored
    image, world = of_images[chosen], of_worlds[chosen]
    ratio, cos, sin = states.bowl.unbind(1)
    # The tensor whose first axis is the bowl's.
    axis = torch.stack([torch.stack([cos, sin], 1), torch.stack([sin, -cos], 1)], 1)
    axis = image @ axis @ image.mT
    return States(
        torch.einsum("bij,bntj->bnti", image, states.positions),
        torch.einsum("bij,bntj->bnti", image, states.velocities),
        torch.einsum("bij,bntj->bnti", world, states.spins),
        torch.stack([ratio, axis[:, 0, 0], axis[:, 0, 1]], 1),
    )


@cache
def _symmetries() -> tuple[Tensor, Tensor]:
    """Return the symmetries of image vectors [8, 2, 2] and of angular velocities [8, 3, 3]."""
    images: list[np.ndarray] = []
    worlds: list[np.ndarray] = []
    middle = NETWORK_FRAME_SIZE / 2
    unseen = np.zeros((0, *FRAME_SHAPE), dtype=np.uint8)
    for mirror in (False, True):
        for quarter_turns in range(4):
            units = Window(unseen, middle + np.eye(2)[None], np.eye(3)[None])
            moved = Symmetry(quarter_turns, mirror).apply(units)
            images.append((moved.positions[0] - middle).T)
            worlds.append(moved.angular_velocities[0].T)
    return torch.tensor(np.stack(images)).float(), torch.tensor(np.stack(worlds)).float()


def _bowl(scene: Scene) -> tuple[float, float, float]:
    if scene.axis_ratio is None:
        return 0.0, 0.0, 0.0
    # The image's y points down.
    angle = -2 * scene.rotation_rad
    return scene.axis_ratio, float(np.cos(angle)), float(np.sin(angle))
