"""``make soak``: the real service for 100,000 mixed requests, 5,000 simulations among them.

Every answer's status is checked. Prints, in even steps, the service's memory, descriptors and
threads, those of the process that simulates, and the times of forecasts; exits with 1 when
anything but its noise has grown.
"""

import argparse
import asyncio
import itertools
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import aiohttp
import numpy as np
import psutil

from rollcast import markdown
from tests.bench.harness import answering, service
from tests.bench.loop import MODEL
from tests.bench.payloads import KINDS, Payload, frames, payload, simulation

CONNECTIONS = 4
WINDOWS = 20
ALLOWED_GROWTH_MIB = 16.0
"""Of the serving process after the first quarter: about 200 bytes a request."""
ALLOWED_SLOWING = 1.5
JSON = {"Content-Type": "application/json"}


@dataclass(frozen=True)
class Request:
    """One of the mix, and the status that it must get."""

    kind: str
    payload: Payload
    status: int = 200
    method: str = "POST"


@dataclass
class Window:
    """What was seen in one even part of the run."""

    requests: int
    memory_mib: float
    simulating_mib: float
    descriptors: int
    threads: int
    median_ms: float
    p99_ms: float

    def row(self) -> str:
        """Markdown."""
        return markdown.row(
            (
                self.requests,
                f"{self.memory_mib:.1f}",
                f"{self.simulating_mib:.1f}",
                self.descriptors,
                self.threads,
                f"{self.median_ms:.1f}",
                f"{self.p99_ms:.1f}",
            )
        )


def mix() -> list[Request]:
    """100 requests in the proportions of the whole, spread evenly."""
    images = frames()
    whole = [payload(kind, images) for kind in KINDS]
    asked = json.loads(whole[KINDS.index("json")].body)

    def posted(path: str, body: object) -> Payload:
        return Payload(path, JSON, json.dumps(body).encode())

    def got(path: str) -> Request:
        return Request("read", Payload(path, {}, b""), method="GET")

    short = posted("/predict", asked | {"horizon": 2})
    refused = [
        Request("refused", posted("/predict", {"frames": ["?"] * 4}), 422),
        Request("refused", Payload("/predict", JSON, b'{"frames": NaN}'), 400),
        Request("refused", posted("/predict", asked | {"model": "nobody"}), 404),
        Request("refused", posted("/predict/stream", asked | {"horizon": 0}), 422),
        Request("refused", posted("/predict", asked | {"frames": asked["frames"][:3]}), 422),
        Request("refused", Payload("/predict", {"Content-Type": "text/plain"}, b"x"), 415),
        Request("refused", replace(whole[1], body=whole[1].body[:-900]), 422),
        Request("refused", posted("/simulate", {"scenario": "moon", "seed": 1}), 422),
        Request("refused", Payload(f"/v2/models/{MODEL}/infer", JSON, b'{"inputs": []}'), 400),
    ]
    read = [
        got("/health/ready"),
        got("/models"),
        got(f"/v2/models/{MODEL}"),
        got("/metrics"),
        got(f"/models/{MODEL}"),
        got("/v2"),
        got("/"),
    ]
    groups = [
        [Request("forecast", one) for one in itertools.islice(itertools.cycle(whole), 18)],
        [Request("short forecast", short)] * 12,
        [Request("stream", posted("/predict/stream", asked | {"horizon": 5}))] * 5,
        [Request("simulation", simulation())] * 5,
        list(itertools.islice(itertools.cycle(refused), 32)),
        list(itertools.islice(itertools.cycle(read), 28)),
    ]
    spread = [
        ((index + 0.5) / len(group), request)
        for group in groups
        for index, request in enumerate(group)
    ]
    return [request for _, request in sorted(spread, key=lambda pair: pair[0])]


class Soak:
    """Asks on and on, and looks at the service now and then."""

    def __init__(self, address: str, process: psutil.Process, requests: int) -> None:
        self._address = address
        self._process = process
        self._most = requests
        self._sent = 0
        self.kinds: Counter[str] = Counter()
        self.failures: Counter[str] = Counter()
        self.windows: list[Window] = []
        self._times: list[float] = []

    async def run(self, requests: Sequence[Request]) -> None:
        """Send all."""
        rest = itertools.islice(itertools.cycle(requests), self._most)
        timeout = aiohttp.ClientTimeout(total=120)
        async with aiohttp.ClientSession(self._address, timeout=timeout) as session:
            await asyncio.gather(*(self._ask_on(session, rest) for _ in range(CONNECTIONS)))

    async def _ask_on(self, session: aiohttp.ClientSession, rest: Iterator[Request]) -> None:
        for request in rest:
            begun = time.perf_counter()
            sent = request.payload
            try:
                async with session.request(
                    request.method, sent.path, data=sent.body or None, headers=sent.headers
                ) as response:
                    await response.read()
                    told = str(response.status)
            except (aiohttp.ClientError, TimeoutError) as error:
                told = type(error).__name__
            if told != str(request.status):
                self.failures[f"{request.kind}: {told} instead of {request.status}"] += 1
            if request.kind == "forecast":
                self._times.append(time.perf_counter() - begun)
            self.kinds[request.kind] += 1
            self._sent += 1
            if self._sent % (self._most // WINDOWS) == 0:
                self._check()

    def _check(self) -> None:
        serving = answering(self._process)
        children = [child for one in serving for child in one.children(recursive=True)]
        simulating = sum(child.memory_info().rss for child in children if child.is_running())
        self.windows.append(
            Window(
                self._sent,
                sum(one.memory_info().rss for one in serving) / 2**20,
                simulating / 2**20,
                sum(one.num_fds() for one in serving),
                sum(one.num_threads() for one in serving),
                1e3 * float(np.median(self._times)),
                1e3 * float(np.quantile(self._times, 0.99)),
            )
        )
        self._times.clear()
        print(self.windows[-1].row(), flush=True)


def verdict(windows: Sequence[Window]) -> list[str]:
    """What has grown."""
    quarter = len(windows) // 4
    early, late = windows[quarter // 2 : quarter], windows[-quarter:]

    def middle(of: Sequence[Window], name: str) -> float:
        return float(np.median([getattr(window, name) for window in of]))

    grown = windows[-1].memory_mib - windows[quarter - 1].memory_mib
    found = [] if grown <= ALLOWED_GROWTH_MIB else [f"memory grew by {grown:.1f} MiB"]
    for name in ("descriptors", "threads"):
        if middle(late, name) > middle(early, name) + 1:
            found.append(f"{name} grew")
    if middle(late, "median_ms") > ALLOWED_SLOWING * middle(early, "median_ms"):
        found.append("forecasts became slower")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=100_000)
    given = parser.parse_args()
    head = ("requests", "memory MiB", "simulating MiB", "descriptors", "threads", "median ms",
            "p99 ms")  # fmt: skip
    print(markdown.header(head), flush=True)
    begun = time.monotonic()
    with service() as (address, process):
        soak = Soak(address, process, given.requests)
        asyncio.run(soak.run(mix()))
    found = verdict(soak.windows) + [f"{n} times {what}" for what, n in soak.failures.items()]
    print(f"\n{dict(soak.kinds)} in {time.monotonic() - begun:.0f} s")
    print("; ".join(found) or "flat, every answer as it should be")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
