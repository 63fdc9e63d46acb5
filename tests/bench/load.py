"""The client of all benchmarks: connections that ask without a pause, or requests at a fixed rate.

python -m tests.bench.load URL MODEL --kind binary --connections 16 --seconds 5
python -m tests.bench.load URL MODEL --rate 300 --seconds 60

Prints as JSON the times of the answers by status, and this program's own processor time.
"""

import argparse
import asyncio
import json
import time
from collections import defaultdict

import aiohttp

from tests.bench.payloads import Payload, frames, payload

Times = dict[int, list[float]]
"""Seconds of every answer, by status."""


class Client:
    """Sends one request again and again."""

    def __init__(self, session: aiohttp.ClientSession, request: Payload) -> None:
        self._session = session
        self._request = request
        self.times: Times = defaultdict(list)

    async def ask(self) -> None:
        """Send it once."""
        begun = time.perf_counter()
        request = self._request
        async with self._session.post(
            request.path, data=request.body, headers=request.headers
        ) as response:
            await response.read()
        self.times[response.status].append(time.perf_counter() - begun)

    async def ask_until(self, end: float) -> None:
        """Send it whenever the last answer is there."""
        while time.perf_counter() < end:
            await self.ask()

    async def ask_at_rate(self, rate: float, seconds: float) -> None:
        """Send it so many times a second, whether answers come or not."""
        begun = time.perf_counter()
        asked: list[asyncio.Task[None]] = []
        while (now := time.perf_counter() - begun) < seconds:
            while len(asked) < rate * now:
                asked.append(asyncio.create_task(self.ask()))
            await asyncio.sleep(1 / rate)
        await asyncio.gather(*asked)


async def load(
    url: str, request: Payload, seconds: float, connections: int = 0, rate: float | None = None
) -> Times:
    """Put a load on a server; no number of connections means as many as are needed."""
    connector = aiohttp.TCPConnector(limit=connections)
    async with aiohttp.ClientSession(url, connector=connector) as session:
        client = Client(session, request)
        if rate is None:
            end = time.perf_counter() + seconds
            await asyncio.gather(*(client.ask_until(end) for _ in range(connections)))
        else:
            await client.ask_at_rate(rate, seconds)
        return client.times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("url")
    parser.add_argument("model")
    parser.add_argument("--kind", choices=["binary", "multipart", "json"], default="binary")
    parser.add_argument("--connections", type=int, default=1)
    parser.add_argument("--rate", type=float, help="requests a second")
    parser.add_argument("--seconds", type=float, default=5)
    given = parser.parse_args()
    request = payload(given.kind, given.model, frames())
    asyncio.run(load(given.url, request, 0.3, connections=1))
    used = time.process_time()
    connections = given.connections if given.rate is None else 0
    times = asyncio.run(load(given.url, request, given.seconds, connections, given.rate))
    used = time.process_time() - used
    print(json.dumps({"times_s": times, "client_s": used}))


if __name__ == "__main__":
    main()
