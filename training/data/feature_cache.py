"""Cache of the outputs of a trained perception for training windows."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from training.common.distributed import Share
from training.common.precision import mixed_precision
from training.common.run_folder import save_whole
from training.data.windows import FRAME_SHAPE, Batch
from training.networks.recurrent import InitialState, PerceptionFamily, State

TRUTH = ("positions", "angular_velocities")


def read_windows(
    family: PerceptionFamily, stream: Iterator[Batch], windows: int, path: Path
) -> None:
    """Write the perception outputs of a number of windows, with their true states.

    Parameters
    ----------
    stream
        Batches with frames.
    path
        File of the features, written whole or not at all.
    """
    device = next(family.parameters()).device
    kept: dict[str, list[torch.Tensor]] = {}
    seen = 0
    family.eval()
    progress = tqdm(total=windows, unit="window", desc="perception")
    while seen < windows:
        batch = next(stream)
        with torch.no_grad(), mixed_precision(device):
            initial = family.initial_state(batch["frames"].to(device))
        # A map of the ground has no use for more digits than halves have.
        read = {"s": initial.state.s.half(), "p": initial.state.p.float()}
        if initial.finals is not None:
            read["finals"] = initial.finals.float()
        for name in TRUTH:
            read[name] = batch[name]
        for name, part in read.items():
            kept.setdefault(name, []).append(part.cpu())
        seen += len(batch["frames"])
        progress.update(len(batch["frames"]))
    progress.close()
    features = {name: torch.cat(parts) for name, parts in kept.items()}
    save_whole(path, features)


def replayed(
    path: Path, batch_size: int, seed: int, first_batch: int, share: Share
) -> Iterator[Batch]:
    """Draw a share of endless batches of cached features; batch k depends on seed and k only."""
    features = torch.load(path, weights_only=True)
    number = first_batch
    own = share.of(batch_size)
    while True:
        generator = np.random.default_rng([seed, number])
        drawn_rows = torch.from_numpy(generator.integers(len(features["p"]), size=batch_size))
        rows = drawn_rows[own.start :: own.step]
        drawn = {name: part[rows] for name, part in features.items()}
        yield Batch(
            frames=torch.empty(len(own), 0, *FRAME_SHAPE, dtype=torch.uint8),
            initial_state=InitialState(State(drawn["s"].float(), drawn["p"]), drawn.get("finals")),
            positions=drawn["positions"],
            angular_velocities=drawn["angular_velocities"],
        )
        number += 1
