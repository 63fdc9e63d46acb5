"""The client of all benchmarks: connections that ask without a pause, or requests at a fixed rate.

python -m tests.bench.load URL --kinds binary --connections 16 --seconds 5
python -m tests.bench.load URL --kinds binary json --simulate 50 --requests 2000
python -m tests.bench.load URL --rate 300 --seconds 60

Prints as JSON the times of the answers by status, this program's own processor time, and the time
until the last answer: requests that were sent in time are waited for.
"""

import argparse
import asyncio
import itertools
import json
import math
import time
from collections import defaultdict
from collections.abc import Sequence

import aiohttp

from tests.bench.payloads import KINDS, Payload, frames, payload, simulation

Times = dict[int, list[float]]
"""Seconds of every answer, by status."""


class Client:
    """Sends requests in turn, again and again."""

    def __init__(self, session: aiohttp.ClientSession, requests: Sequence[Payload]) -> None:
        self._session = session
        self._requests = itertools.cycle(requests)
        self.sent = 0
        self.times: Times = defaultdict(list)

    async def ask(self) -> None:
        """Send the next one."""
        begun = time.perf_counter()
        request = next(self._requests)
        self.sent += 1
        async with self._session.post(
            request.path, data=request.body, headers=request.headers
        ) as response:
            await response.read()
        self.times[response.status].append(time.perf_counter() - begun)

    async def ask_on(self, end: float, most: float) -> None:
        """Send the next whenever the last answer is there, until some time or number is reached."""
        while time.perf_counter() < end and self.sent < most:
            await self.ask()

    async def ask_at_rate(self, rate: float, seconds: float) -> None:
        """Send so many a second, whether answers come or not."""
        begun = time.perf_counter()
        asked: list[asyncio.Task[None]] = []
        while (now := time.perf_counter() - begun) < seconds:
            while len(asked) < rate * now:
                asked.append(asyncio.create_task(self.ask()))
            await asyncio.sleep(1 / rate)
        await asyncio.gather(*asked)


async def load(
    url: str,
    requests: Sequence[Payload],
    seconds: float = math.inf,
    connections: int = 0,
    rate: float | None = None,
    most: float = math.inf,
) -> Times:
    """Put a load on a server; no number of connections means as many as are needed."""
    connector = aiohttp.TCPConnector(limit=connections)
    async with aiohttp.ClientSession(url, connector=connector) as session:
        client = Client(session, requests)
        if rate is None:
            end = time.perf_counter() + seconds
            await asyncio.gather(*(client.ask_on(end, most) for _ in range(connections)))
        else:
            await client.ask_at_rate(rate, seconds)
        return client.times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("url")
    parser.add_argument("--kinds", choices=[*KINDS, "listed"], nargs="+", default=["binary"])
    parser.add_argument("--simulate", type=int, metavar="N", help="every Nth is a simulation")
    parser.add_argument("--connections", type=int, default=1)
    parser.add_argument("--rate", type=float, help="requests a second")
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--requests", type=int)
    given = parser.parse_args()
    if given.seconds is None and given.requests is None:
        parser.error("how long? --seconds or --requests")
    images = frames()
    forecasts = [payload(kind, images) for kind in given.kinds]
    asyncio.run(load(given.url, forecasts, 0.3, connections=1))
    requests = forecasts
    if given.simulate is not None:
        others = itertools.islice(itertools.cycle(forecasts), given.simulate - 1)
        requests = [*others, simulation()]
    seconds, most = given.seconds or math.inf, given.requests or math.inf
    connections = given.connections if given.rate is None else 0
    used, begun = time.process_time(), time.perf_counter()
    times = asyncio.run(load(given.url, requests, seconds, connections, given.rate, most))
    used, wall = time.process_time() - used, time.perf_counter() - begun
    print(json.dumps({"times_s": times, "client_s": used, "wall_s": wall}))


if __name__ == "__main__":
    main()
