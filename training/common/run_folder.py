"""Files in the folder of a training run."""

from pathlib import Path
from typing import Any

import torch

CHECKPOINT = "checkpoint.pt"
BEST = "best.pt"
EVENTS = "events"
"""Folder of TensorBoard's events."""
LOSS = "training/loss"
"""Tag of the events; all others are errors in px."""


def read_best(folder: Path) -> dict[str, Any]:
    """Return the weights with the least validation error, with their metadata."""
    return torch.load(folder / BEST, map_location="cpu", weights_only=True)


def save_whole(path: Path, content: dict[str, Any]) -> None:
    """Write a file so that it is never seen half-written."""
    unfinished = path.with_suffix(".tmp")
    torch.save(content, unfinished)
    unfinished.replace(path)
