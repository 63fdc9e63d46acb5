"""Metrics of several processes, in memory-mapped files whose room is reserved beforehand.

A write to a mapped page that the file system has no room for ends the process with SIGBUS. Files
are therefore allocated in full before a process writes, and the labels of all metrics come from
closed sets, so that a file never grows.
"""

import os
from collections.abc import Iterable
from pathlib import Path

from prometheus_client import values

FILE_KINDS = ("counter", "gauge_livemostrecent", "gauge_livesum", "histogram", "summary")
"""First parts of the names of a process's files: one for each kind of metric that there is."""
FILE_BYTES = 2**20
"""Size of each file: some 7,000 values, more than the labels of the committed models make."""


def reserve_metrics(folder: Path, name: str, kinds: Iterable[str] = FILE_KINDS) -> None:
    """Allocate the files of one process, or those of some kinds.

    Raises
    ------
    OSError
        When there is no room for them.
    """
    for kind in kinds:
        with (folder / f"{kind}_{name}.db").open("ab") as file:
            os.posix_fallocate(file.fileno(), 0, FILE_BYTES)


def write_metrics_as(name: str) -> None:
    """Write this process's metrics to the files of a name from now on, not to those of its pid.

    A process that replaces another takes over its name: its counters go on, and it needs no room.
    """
    values.ValueClass = values.MultiProcessValue(  # pyright: ignore[reportUnknownMemberType]
        lambda: name
    )
