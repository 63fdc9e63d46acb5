"""PyBullet, imported without the line about its build, which it prints from C.

Its versions print it to stdout or to stderr.
"""

import ctypes
import os
from collections.abc import Generator
from contextlib import ExitStack, contextmanager

from rollcast.errors import MissingExtraError

STDOUT, STDERR = 1, 2


@contextmanager
def _silenced(descriptor: int) -> Generator[None]:
    """Discard all output to a descriptor, also that of C libraries."""
    try:
        kept = os.dup(descriptor)
    except OSError:  # it is closed
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    flush = ctypes.CDLL(None).fflush
    flush(None)
    os.dup2(nowhere, descriptor)
    try:
        yield
    finally:
        flush(None)  # C keeps lines for a pipe or file, and would write them later
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


try:
    with ExitStack() as stack:
        for descriptor in (STDOUT, STDERR):
            stack.enter_context(_silenced(descriptor))
        import pybullet as pybullet
except ImportError as error:
    raise MissingExtraError("simulations need", "pybullet", "simulation") from error
