"""A control loop at camera rate: latency and jitter of a session beside calls of ``predict``.

python -m tests.bench.control_loop [--seconds 20] [--rate 30] [--model fieldnet] [--size 128]

Frames go to a service of the defaults on this machine. The latency of a tick is the time from the
frame as an array to its forecast as arrays; jitter is the standard deviation of the latency.
"""

import argparse
import os
import time
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

from rollcast import markdown
from rollcast.client import Client, Forecast
from rollcast.trajectory import OBSERVED_FRAMES
from tests.bench.harness import service

HORIZON = 20
ROUNDS = 2
"""Rounds of each way, in turn."""

Tick = Callable[[int], Forecast | None]
"""Sends the frame of a number; returns its forecast."""


def loop(tick: Tick, rate: float, seconds: float) -> tuple[np.ndarray, int]:
    """Return the latencies of a loop in milliseconds, and how many ticks began late."""
    latencies: list[float] = []
    late = 0
    begun = time.perf_counter()
    for number in range(int(rate * seconds)):
        due = begun + number / rate
        if (left := due - time.perf_counter()) > 0:
            time.sleep(left)
        else:
            late += number > 0
        sent = time.perf_counter()
        if tick(number) is not None:
            latencies.append(1e3 * (time.perf_counter() - sent))
    return np.array(latencies), late


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--rate", type=float, default=30)
    parser.add_argument("--model", default="fieldnet")
    parser.add_argument("--size", type=int, default=128)
    asked = parser.parse_args()
    found: dict[str, list[tuple[np.ndarray, int]]] = {"`session`": [], "`predict`": []}
    with service() as (address, _), ExitStack() as stack:
        client = stack.enter_context(Client(address))
        frames = client.simulate("hemisphere", seed=7, image_size=asked.size, steps=60).frames
        options = {"horizon": HORIZON, "model": asked.model}

        def predict(number: int) -> Forecast | None:
            first = number % (len(frames) - OBSERVED_FRAMES)
            return client.predict(frames[first : first + OBSERVED_FRAMES], **options)

        for _ in range(ROUNDS):
            with client.session(**options) as session:

                def send(number: int, session=session) -> Forecast | None:
                    session.send(frames[number % len(frames)])
                    return session.receive().forecast

                found["`session`"].append(loop(send, asked.rate, asked.seconds))
            found["`predict`"].append(loop(predict, asked.rate, asked.seconds))
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {asked}")
    heads = ("way", "forecasts", "median ms", "p90", "p99", "largest", "jitter ms", "late ticks")
    rows: list[tuple[object, ...]] = []
    for way, rounds in found.items():
        ms = np.concatenate([latencies for latencies, _ in rounds])
        figures = [*np.percentile(ms, [50, 90, 99]), ms.max(), ms.std()]
        late = sum(late for _, late in rounds)
        rows.append((way, len(ms), *(f"{figure:.1f}" for figure in figures), late))
    print(markdown.table(heads, rows))


if __name__ == "__main__":
    main()
