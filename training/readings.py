"""What a taught eye reads of training windows, kept: seen once, rehearsed as often as one likes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from training.dataset import FRAME_SHAPE, Batch
from training.models.predictor import Network, State

TRUTH = ("positions", "angular_velocities")


def read_windows(network: Network, stream: Iterator[Batch], windows: int, path: Path) -> None:
    """Write the states that a network begins with, and the truth, for so many windows.

    Parameters
    ----------
    stream
        Batches with frames.
    path
        File that the readings go to, whole or not at all.
    """
    device = next(network.parameters()).device
    kept: dict[str, list[torch.Tensor]] = {name: [] for name in (*State._fields, *TRUTH)}
    seen = 0
    network.eval()
    while seen < windows:
        batch = next(stream)
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16):
            state = network.start(batch["frames"].to(device))
        # A map of the ground has no use for more digits than halves have.
        kept["s"].append(state.s.half().cpu())
        kept["p"].append(state.p.float().cpu())
        for name in TRUTH:
            kept[name].append(batch[name])
        seen += len(batch["frames"])
    readings = {name: torch.cat(parts) for name, parts in kept.items()}
    unfinished = path.with_suffix(".tmp")
    torch.save(readings, unfinished)
    unfinished.replace(path)


def rehearsed(path: Path, batch_size: int, seed: int, first_batch: int) -> Iterator[Batch]:
    """Draw batches of readings for ever; batch k depends on the seed and on k alone."""
    readings = torch.load(path, weights_only=True)
    number = first_batch
    while True:
        generator = np.random.default_rng([seed, number])
        drawn = torch.from_numpy(generator.integers(len(readings["p"]), size=batch_size))
        yield Batch(
            frames=torch.empty(batch_size, 0, *FRAME_SHAPE, dtype=torch.uint8),
            state=(readings["s"][drawn].float(), readings["p"][drawn]),
            positions=readings["positions"][drawn],
            angular_velocities=readings["angular_velocities"][drawn],
        )
        number += 1
