"""Where training keeps what must not enter the repository. The only reader of its environment."""

import os
from pathlib import Path


def runs_folder() -> Path:
    """Folder of data sets and checkpoints: ROLLCAST_RUNS, or ``runs`` in the working directory."""
    return Path(os.environ.get("ROLLCAST_RUNS", "runs"))
