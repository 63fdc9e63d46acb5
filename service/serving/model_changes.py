"""Models loaded and unloaded while several worker processes serve: one file that all follow.

The file holds the last change of each model and is replaced in one step, so that every reader sees
a whole state: a worker that starts later, or misses some changes, ends with the same models.
"""

import asyncio
import fcntl
import json
import os
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

from service.errors import NotReadyError

Action: TypeAlias = Literal["load", "unload"]

CHANGES_FILE = "model-changes.json"
LOCK_FILE = "lock"
LOCK_TIMEOUT_S = 15.0
"""Time to wait for a worker that stopped while it was writing, until the supervisor replaces it."""
LOCK_POLL_S = 0.02


class ModelChange(NamedTuple):
    """The last change of one model, with its number among all changes."""

    generation: int
    action: Action
    name: str


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
        self._path = folder / CHANGES_FILE
        self._lock = folder / LOCK_FILE
        known = self._read()
        self._applied = max((change.generation for change in known), default=0)
        self.unloaded = [change.name for change in known if change.action == "unload"]

    @staticmethod
    def prepare(folder: Path) -> None:
        """Make the files of an empty folder, before the first worker starts."""
        (folder / LOCK_FILE).touch()
        (folder / CHANGES_FILE).write_text("[]", encoding="utf-8")

    async def record(self, action: Action, name: str) -> int:
        """Write a change for all workers; return its generation.

        Raises
        ------
        NotReadyError
            When it cannot be written: nothing has changed.
        """
        try:
            async with self._locked():
                known = self._read()
                generation = 1 + max((change.generation for change in known), default=0)
                kept = [change for change in known if change.name != name]
                text = json.dumps([*kept, ModelChange(generation, action, name)])
                unfinished = self._path.with_suffix(".tmp")
                unfinished.write_text(text, encoding="utf-8")
                unfinished.replace(self._path)
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise NotReadyError(
                f"The change cannot be shared by all processes: {reason}."
            ) from error
        return generation

    def newer(self) -> list[ModelChange]:
        """Return the changes after those that this worker has applied, in their order."""
        return sorted(change for change in self._read() if change.generation > self._applied)

    def mark_applied(self, change: ModelChange) -> None:
        """Note that this worker has applied a change, and all before it."""
        self._applied = change.generation

    def _read(self) -> list[ModelChange]:
        return [ModelChange(*change) for change in json.loads(self._path.read_bytes())]

    @asynccontextmanager
    async def _locked(self) -> AsyncGenerator[None]:
        """Keep other workers from writing; a worker that is killed loses its lock."""
        deadline = time.monotonic() + LOCK_TIMEOUT_S
        with self._lock.open("rb") as file:
            while True:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        raise
                await asyncio.sleep(LOCK_POLL_S)
            yield
