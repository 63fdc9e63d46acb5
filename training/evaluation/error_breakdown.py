"""Takes the error of a network with an explicit state apart: parts of it are replaced by the truth.

The error that the truth of a part removes is the error due to its estimate; the error that remains
with the truth of all parts is that of the motion.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from rollcast.markdown import table
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import OBSERVED_FRAMES
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, load_recordings, simulate_split
from training.data.windows import WindowMaker, collate, compared_horizon, generated_horizon
from training.networks.fieldnet import Ball, FieldNet, true_state
from training.networks.recurrent import State

SUBSTITUTES: Mapping[str, tuple[str, ...]] = {
    "nothing": (),
    "the ground": ("ground",),
    "the centre": ("centre",),
    "the velocity": ("velocity",),
    "the spin": ("spin",),
    "centre, velocity and spin": ("centre", "velocity", "spin"),
    "everything": ("ground", "centre", "velocity", "spin"),
}
"""Replaced parts of the state, by name."""


def breakdown_of(
    network: FieldNet, source: Source, scenes: int, workers: int
) -> dict[str, np.ndarray]:
    """Return the mean error in pixels at every step up to T_gen for each of SUBSTITUTES."""
    shards = simulate_split(source, "validation", scenes, workers)
    maker = WindowMaker(
        load_recordings(shards), None, load_scene_cache(shards, workers), scene_targets=True
    )
    horizon = generated_horizon(source.objects)
    start = TEST_START[source.scenario]
    batch = collate([maker.window(index, start, horizon) for index in range(scenes)])
    assert "scene_targets" in batch
    centres, ground, constants = batch["scene_targets"]
    with torch.inference_mode():
        seen = network.start(batch["frames"])
        spins = batch["angular_velocities"][:, :, 0]
        truth = true_state(centres[:, :, :OBSERVED_FRAMES], spins, ground, constants)
        errors: dict[str, np.ndarray] = {}
        for name, parts in SUBSTITUTES.items():
            rolled = network.roll_out(_mixed(seen, truth, parts), horizon).positions
            errors[name] = (rolled - batch["positions"]).norm(dim=-1).mean(dim=(0, 1)).numpy()
    return errors


def _mixed(seen: State, truth: State, parts: Sequence[str]) -> State:
    """Return the seen state with parts of the true one; scale and radius go with the ground."""
    true_ball = Ball.unpacked(truth.p)._asdict()
    taken = {part: true_ball[part] for part in parts if part != "ground"}
    if "ground" in parts:
        taken["scene_constants"] = true_ball["scene_constants"]
    ball = Ball.unpacked(seen.p)._replace(**taken)
    return State(truth.s if "ground" in parts else seen.s, ball.packed())


def breakdown_table(errors: Mapping[str, Mapping[str, np.ndarray]], objects: int) -> str:
    """Mean errors in pixels by scenario as a Markdown table."""
    horizons = (compared_horizon(objects), generated_horizon(objects))
    columns = [f"{scenario}, T={horizon}" for scenario in errors for horizon in horizons]
    return table(
        ("true", *columns),
        [
            (
                name,
                *(
                    f"{by_part[name][horizon - 1]:.2f}"
                    for by_part in errors.values()
                    for horizon in horizons
                ),
            )
            for name in SUBSTITUTES
        ],
    )
