"""Calls in threads that a process which ends does not wait for.

``asyncio.to_thread`` has threads that both the event loop and the interpreter join at their end,
however long they take: for a model on a disk that does not answer, for ever.
"""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


async def run_in_daemon_thread(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Run a call in a daemon thread of its own and return its result."""
    future: Future[T] = Future()

    def run() -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(call(*args, **kwargs))
        except BaseException as error:  # is raised where the result is awaited
            future.set_exception(error)

    threading.Thread(target=run, name="daemon-call", daemon=True).start()
    return await asyncio.wrap_future(future)
