"""Processes that compute side by side."""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.pool import Pool


@contextmanager
def process_pool(workers: int, tasks_per_process: int | None = None) -> Iterator[Pool]:
    """Start processes that end with the block, also by Ctrl-C.

    Ctrl-C in a terminal reaches every process of a command. Only the one that waits for the others
    hears it: those, and the ones that replace them, inherit a mask, so that not even their start
    ends in a traceback.

    Parameters
    ----------
    workers
        Number of processes.
    tasks_per_process
        Number of tasks after which a process is replaced; by default it never is.
    """
    heard = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        pool = multiprocessing.get_context("spawn").Pool(
            workers, maxtasksperchild=tasks_per_process
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, heard)
    with pool:
        yield pool
