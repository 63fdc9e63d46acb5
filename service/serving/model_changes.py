"""Models loaded and unloaded while several worker processes serve.

The workers share a folder with a file for each model that was changed since the start: its last
change. Files are replaced in one step, so that readers see whole ones; a worker that starts later,
or misses a change that another one follows, ends with the same models as the others.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, TypeAlias, cast

Action: TypeAlias = Literal["load", "unload"]


class ModelChanges:
    """Changes of models, as one worker process reads and writes them.

    Parameters
    ----------
    folder
        Folder that all workers share.

    Attributes
    ----------
    unloaded
        Names of the models that were unloaded when this object was made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "changes"
        self._folder.mkdir(exist_ok=True)
        self._unfinished = folder / f"change-{os.getpid()}"
        self._seen: dict[str, tuple[int, int]] = {}
        self.unloaded = [name for action, name in self.newer() if action == "unload"]

    def record(self, action: Action, name: str) -> None:
        """Notify all other workers of a model change.

        Raises
        ------
        OSError
            If the file system is full; no worker is notified.
        """
        self._unfinished.write_text(action, encoding="utf-8")
        status = self._unfinished.stat()
        self._unfinished.replace(self._folder / name)
        self._seen[name] = status.st_ino, status.st_mtime_ns

    def newer(self) -> Iterator[tuple[Action, str]]:
        """Yield the changes that other workers have recorded since the last call."""
        for path in self._folder.iterdir():
            status = path.stat()
            version = status.st_ino, status.st_mtime_ns
            if self._seen.get(path.name) != version:
                self._seen[path.name] = version
                yield cast("Action", path.read_text(encoding="utf-8")), path.name
