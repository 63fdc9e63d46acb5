"""Reading files whose names a user or operator gives."""

import os
import stat
from pathlib import Path


def read_regular_file(path: Path) -> bytes:
    """Return the content of a regular file.

    Pipes, sockets and devices are refused without being waited for: reading one may never end.

    Raises
    ------
    OSError
        When the file cannot be read, or is not a regular file.
    """
    # Without O_NONBLOCK, opening a pipe waits for its writer.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
    flags |= getattr(os, "O_BINARY", 0)
    with os.fdopen(os.open(path, flags), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(f"{path.name} is not a regular file")
        return file.read()
