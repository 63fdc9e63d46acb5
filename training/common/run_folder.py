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
RENAMED_PARTS = {
    "eye": "perception",
    "first_doubt": "first_covariance",
    "doubt": "covariance_change",
    "unsure": "covariance_from_sigmas",
    "encounters": "pair_interaction",
    "measures": "scene_constants",
    "bend": "endpoint_correction",
    "look": "refiner",
    "looks": "radius_and_visibility",
}
"""Parts of parameter names that older run folders and committed graphs have, and their successors.
"""


def read_best(folder: Path) -> dict[str, Any]:
    """Return the weights with the least validation error, with their metadata."""
    return read_whole(folder / BEST)


def read_whole(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a file of weights; parameters with a former name get the current one."""
    return _renamed(torch.load(path, map_location=device, weights_only=True))


def current_name(parameter: str) -> str:
    """Return the current name of a parameter, which may have a former one."""
    return ".".join(RENAMED_PARTS.get(part, part) for part in parameter.split("."))


def _renamed(content: dict[Any, Any]) -> dict[Any, Any]:
    """Rename the keys of a state dict, or of the state dicts in a dictionary."""
    return {
        current_name(key) if isinstance(key, str) else key: (
            _renamed(value) if isinstance(value, dict) else value
        )
        for key, value in content.items()
    }


def save_whole(path: Path, content: dict[str, Any]) -> None:
    """Write a file so that it is never seen half-written."""
    unfinished = path.with_suffix(".tmp")
    torch.save(content, unfinished)
    unfinished.replace(path)
