"""A plan for a million forecasts a second, from what was measured, and a simulation of its queue.

The crowd is so large that it flows: in every tenth of a second a Poisson number of requests comes,
the replicas that are there answer what they can, and the rest waits or is refused.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

RATE = 1_000_000
"""Forecasts a second."""
TICK_S = 0.1
DURATION_S = 900
BURST_S = (300, 600)
"""When half as many again come."""
BURST = 1.5
LOADS = (0.5, 0.6, 0.7, 0.8)
"""Shares of the replicas' time that the usual crowd takes."""
UPSCALE_DELAY_S = 30
LOOK_BACK_S = 30
"""Ray Serve's autoscaling, as it is by default."""
NODE_START_S = 90
"""Until a cloud has given a machine: assumed."""
WAITING_S = 1.0
"""Longest queue: what would wait longer is refused."""
CORE_HOUR_USD = 0.04
"""Of a core that is rented by the hour: assumed."""


@dataclass(frozen=True)
class Fleet:
    """What became of a crowd, tick by tick."""

    load: float
    arrivals: np.ndarray
    replicas: np.ndarray
    wait_s: np.ndarray
    refused: np.ndarray

    @property
    def lost(self) -> float:
        """Share of all requests that was refused."""
        return float(self.refused.sum() / self.arrivals.sum())


def simulate(per_replica: float, replica_start_s: float, load: float) -> Fleet:
    """Let a crowd come to as many replicas as it usually needs, half as many again for a while.

    Parameters
    ----------
    per_replica
        Forecasts a second that a replica, of one core, answers.
    replica_start_s
        Seconds until a started replica answers.
    load
        Share of the replicas' time that the usual crowd takes.
    """
    generator = np.random.default_rng(0)
    times = np.arange(0, DURATION_S, TICK_S)
    burst = (times >= BURST_S[0]) & (times < BURST_S[1])
    arrivals = generator.poisson(RATE * TICK_S * np.where(burst, BURST, 1.0)).astype(float)
    replicas, waits, refused = (np.zeros_like(times) for _ in range(3))
    lag = int((UPSCALE_DELAY_S + NODE_START_S + replica_start_s) / TICK_S)
    look_back = int(LOOK_BACK_S / TICK_S)
    ordered = np.full(len(times) + lag + 1, RATE / load / per_replica)
    waiting = 0.0
    for tick, arrived in enumerate(arrivals):
        capacity = ordered[tick] * per_replica * TICK_S
        waiting += arrived
        waiting -= min(waiting, capacity)
        room = WAITING_S / TICK_S * capacity
        refused[tick] = max(waiting - room, 0.0)
        waiting = min(waiting, room)
        waits[tick] = waiting / capacity * TICK_S
        replicas[tick] = ordered[tick]
        # As many as would bring the crowd of the last half minute back to the usual load.
        seen = arrivals[max(tick - look_back, 0) : tick + 1].mean() / TICK_S
        wanted = seen / load / per_replica
        if wanted > ordered[tick + lag]:
            ordered[tick + lag :] = wanted
    return Fleet(load, arrivals, replicas, waits, refused)


def draw(fleets: list[Fleet], path: Path) -> None:
    """Draw the crowd, the replicas and the wait."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    crowd, replicas, wait = figure.subplots(3, sharex=True)
    times = np.arange(len(fleets[0].arrivals)) * TICK_S
    crowd.plot(times, fleets[0].arrivals / TICK_S / 1e6, color="black", linewidth=0.5)
    crowd.set_ylabel("requests, million/s")
    crowd.set_ylim(0)
    for fleet, style in zip(fleets, ("-", "--", "-.", ":"), strict=True):
        label = f"{fleet.load:.0%} busy, {fleet.lost:.1%} refused"
        replicas.plot(times, fleet.replicas / 1e3, style, label=label)
        wait.plot(times, fleet.wait_s, style)
    replicas.set_ylabel("replicas, thousands")
    replicas.set_ylim(0)
    replicas.legend(loc="lower right")
    wait.set_ylabel("wait in the queue, s")
    wait.set_xlabel("seconds")
    figure.savefig(path, metadata={"Software": None})
