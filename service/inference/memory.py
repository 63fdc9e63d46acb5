"""Memory that is freed goes back to the system."""

import ctypes
from typing import Any

M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
"""Numbers of glibc's options (malloc.h)."""
OWN_MAPPING_BYTES = 16 * 2**20
"""Size from which a block has a mapping of its own, which ends when it is freed.

Perception works in one block, of 3.7 MB for a request and 15 MB for four. A new mapping for each
run made it take 10 ms instead of 7: the system clears every page before it is touched.
"""
KEPT_BYTES = 2 * OWN_MAPPING_BYTES
"""Free memory at the end of the heap that is kept for later."""


def return_freed_memory() -> None:
    """Let large blocks (bodies, pixels) go back to the system as soon as they are freed.

    By default, glibc raises both thresholds when the first large block is freed, and keeps later
    blocks. Without glibc this function has no effect.
    """
    mallopt: Any = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, OWN_MAPPING_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
