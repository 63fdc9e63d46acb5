"""What the awaited client does otherwise than the one that blocks (``rollcast.client._sync``)."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import ParamSpec, TypeVar

from tenacity import AsyncRetrying, retry_if_exception, stop_after_attempt

from rollcast.client.retries import may_pass, wait_s

P = ParamSpec("P")
T = TypeVar("T")


async def off_the_loop(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Do what takes a while, such as packing images, where nobody else has to wait for it."""
    return await asyncio.to_thread(function, *args, **kwargs)


async def repeated(call: Callable[[], Awaitable[T]], retries: int) -> T:
    """Make a call, and again while what failed may pass."""
    async for attempt in AsyncRetrying(
        retry=retry_if_exception(may_pass),
        wait=wait_s,
        stop=stop_after_attempt(1 + retries),
        reraise=True,
    ):
        with attempt:
            return await call()
    raise AssertionError("an attempt returns or raises")


async def side_by_side(calls: Sequence[Callable[[], Awaitable[T]]], at_once: int) -> list[T]:
    """Make many calls, some at once, and return their results in order.

    The first that fails ends the others, and its exception is raised.
    """
    places = asyncio.Semaphore(at_once)

    async def in_turn(call: Callable[[], Awaitable[T]]) -> T:
        async with places:
            return await call()

    tasks = [asyncio.ensure_future(in_turn(call)) for call in calls]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
