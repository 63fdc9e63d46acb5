"""A load on the real service while something goes wrong: every request is counted by its end."""

import asyncio
import itertools
import json
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import aiohttp

from rollcast import markdown
from tests.bench.payloads import KINDS, Payload, frames, payload, simulation

CONNECTIONS = 4
NO_ANSWER = "no end"
"""Nothing came for LONGEST_S: the one outcome that must never be."""
LONGEST_S = 30.0
READY_WITHIN_S = 5.0


@dataclass
class Report:
    """What became of the requests of one fault."""

    fault: str
    ends: Counter[str] = field(default_factory=Counter[str])
    ready_after_s: list[float] = field(default_factory=list[float])
    expected: frozenset[str] = frozenset()
    """Ends that are as good as an answer, for this fault."""

    @property
    def well(self) -> bool:
        """Whether nothing hung or ended otherwise, and the service was soon ready."""
        good = all(end == "200" or end in self.expected for end in self.ends)
        return good and all(after <= READY_WITHIN_S for after in self.ready_after_s)

    def row(self) -> str:
        """Markdown."""
        others = ", ".join(f"{n} x {end}" for end, n in sorted(self.ends.items()) if end != "200")
        slowest = f"{max(self.ready_after_s):.2f} s" if self.ready_after_s else "-"
        return markdown.row(
            (
                self.fault,
                len(self.ready_after_s),
                self.ends.total(),
                self.ends["200"],
                others or "none",
                slowest,
                "yes" if self.well else "**no**",
            )
        )


HEADER = markdown.header(
    ("fault", "times", "requests", "answered", "other ends", "ready after, at most", "as promised")
)


async def one(session: aiohttp.ClientSession, request: Payload) -> str:
    """Send a request; return how it ended."""
    try:
        async with session.post(
            request.path, data=request.body, headers=request.headers
        ) as response:
            content = await response.read()
    except TimeoutError:
        return NO_ANSWER
    except aiohttp.ClientConnectorError:
        return "nobody listens"
    except (aiohttp.ClientError, ConnectionError):
        return "connection closed"
    if response.status == 200:
        return "200"
    if response.content_type != "application/problem+json":
        return str(response.status)
    return f"{response.status} {json.loads(content)['type'].removeprefix('/problems/')}"


class Load:
    """Connections that ask without a pause: forecasts in every form, and simulations."""

    def __init__(self, address: str, report: Report, simulate_every: int = 8) -> None:
        images = frames()
        self.forecast = payload("binary", images)
        requests = [payload(kind, images) for kind in KINDS] * simulate_every
        requests[::simulate_every] = [simulation()] * len(requests[::simulate_every])
        self._requests = itertools.cycle(requests)
        self._address = address
        self._report = report

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Ask as long as the context lasts; then wait for every answer."""
        ended = asyncio.Event()
        timeout = aiohttp.ClientTimeout(total=LONGEST_S)
        async with aiohttp.ClientSession(self._address, timeout=timeout) as session:
            asking = [asyncio.create_task(self._ask(session, ended)) for _ in range(CONNECTIONS)]
            try:
                yield
            finally:
                ended.set()
                await asyncio.gather(*asking)

    async def _ask(self, session: aiohttp.ClientSession, ended: asyncio.Event) -> None:
        while not ended.is_set():
            end = await one(session, next(self._requests))
            self._report.ends[end] += 1
            if end in {"connection closed", "nobody listens"}:
                await asyncio.sleep(0.05)

    async def until_ready(self) -> None:
        """Note how long it takes until a forecast and a simulation are answered again."""
        begun = time.monotonic()
        timeout = aiohttp.ClientTimeout(total=LONGEST_S)
        async with aiohttp.ClientSession(self._address, timeout=timeout) as session:
            for request in (self.forecast, simulation()):
                while await one(session, request) != "200" and time.monotonic() < begun + LONGEST_S:
                    await asyncio.sleep(0.05)
        self._report.ready_after_s.append(time.monotonic() - begun)
