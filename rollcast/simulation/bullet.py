"""PyBullet, imported without the line about its build that it prints to stdout from C."""

import ctypes
import os
from collections.abc import Generator
from contextlib import contextmanager

from rollcast.errors import MissingExtraError


@contextmanager
def _silenced_stdout() -> Generator[None]:
    """Discard all output to the descriptor of stdout."""
    stdout = 1
    try:
        kept = os.dup(stdout)
    except OSError:  # stdout is closed
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    flush = ctypes.CDLL(None).fflush
    flush(None)
    os.dup2(nowhere, stdout)
    try:
        yield
    finally:
        flush(None)  # C keeps lines for a pipe or file, and would write them later
        os.dup2(kept, stdout)
        os.close(kept)
        os.close(nowhere)


try:
    with _silenced_stdout():
        import pybullet as pybullet
except ImportError as error:
    raise MissingExtraError("simulations need", "pybullet", "simulation") from error
