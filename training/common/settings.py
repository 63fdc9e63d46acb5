"""Folders of data sets and checkpoints outside the repository, from the environment."""

import os
from pathlib import Path

RUNS_VARIABLE = "ROLLCAST_RUNS"
"""Variable with the folder of data sets and checkpoints."""


def keep_runtime_silent() -> None:
    """Stop ONNX Runtime from reporting its use (decision 0002); call it before its import."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def runs_folder() -> Path:
    """Folder of data sets and checkpoints: ROLLCAST_RUNS, or ``runs`` in the working directory."""
    return Path(os.environ.get(RUNS_VARIABLE, "runs")).resolve()
