"""Deadlines of forecasts, and cancellation when the client disconnects.

A rollout checks for cancellation between steps, so its worker is free within one step.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import TypeVar

from fastapi import Request

from service.errors import DeadlineExceededError

T = TypeVar("T")


class ClientGoneError(Exception):
    """The client has gone; its answer is not needed."""


class CancellationToken:
    """Cancellation of a request: polled by a worker thread, cancelled by the event loop."""

    def __init__(self) -> None:
        self.cancelled: Future[None] = Future()
        """Future that is done once the request is cancelled."""

    def cancel(self) -> None:
        """Cancel the request."""
        if not self.cancelled.done():
            self.cancelled.set_result(None)

    def raise_if_cancelled(self) -> None:
        """Raise once the request is cancelled.

        Raises
        ------
        ClientGoneError
            When the request is cancelled.
        """
        if self.cancelled.done():
            raise ClientGoneError


async def answered(
    request: Request, timeout: float | None, submit: Callable[[CancellationToken], Future[T]]
) -> T:
    """Submit a call and return its result; without a timeout, the time is unlimited.

    Raises
    ------
    ClientGoneError
        When the client goes away before that.
    DeadlineExceededError
        When it takes longer than ``timeout`` seconds, the wait in the queue included.
    QueueFullError
        When it is not taken.
    """
    gone = asyncio.ensure_future(_disconnect(request))
    try:
        return await awaited(timeout, submit, gone)
    finally:
        gone.cancel()
        with suppress(asyncio.CancelledError, Exception):
            await gone


async def awaited(
    timeout: float | None,
    submit: Callable[[CancellationToken], Future[T]],
    gone: asyncio.Future[None] | None = None,
) -> T:
    """Submit a call and return its result; cancelled, the call is cancelled too.

    Parameters
    ----------
    gone
        Completed when the client goes away; None where its task is cancelled then.

    Raises
    ------
    ClientGoneError, DeadlineExceededError, QueueFullError
        As :func:`answered`.
    """
    token = CancellationToken()
    work = asyncio.wrap_future(submit(token))
    ends = {work} if gone is None else {work, gone}
    try:
        done, _ = await asyncio.wait(ends, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        if work in done:
            return work.result()
        if done:
            raise ClientGoneError
        raise DeadlineExceededError(f"The answer was not there after {timeout:g} s.")
    finally:
        token.cancel()
        work.cancel()


async def streamed(
    request: Request,
    timeout: float,
    submit: Callable[[CancellationToken, Callable[[T], object]], Future[None]],
) -> AsyncGenerator[T]:
    """Submit a call and yield its events as they arrive, until the client disconnects.

    Raises
    ------
    DeadlineExceededError
        When the whole takes longer than ``timeout`` seconds, the wait in the queue included.
    QueueFullError
        When it is not taken.
    """
    loop = asyncio.get_running_loop()
    ends = loop.time() + timeout
    events: asyncio.Queue[T | None] = asyncio.Queue()
    token = CancellationToken()
    running = asyncio.wrap_future(
        submit(token, lambda event: loop.call_soon_threadsafe(events.put_nowait, event))
    )
    gone = asyncio.ensure_future(_disconnect(request))
    for end in (running, gone):
        end.add_done_callback(lambda _: events.put_nowait(None))
    try:
        while (event := await asyncio.wait_for(events.get(), ends - loop.time())) is not None:
            yield event
        if not gone.done():
            await running
    except TimeoutError as error:
        raise DeadlineExceededError(f"The answer was not there after {timeout:g} s.") from error
    finally:
        token.cancel()
        gone.cancel()
        running.cancel()


async def _disconnect(request: Request) -> None:
    """Return when the client goes away; the body has been read."""
    while True:
        message = await request.receive()
        if message["type"] == "http.disconnect":
            return
