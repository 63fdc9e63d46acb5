"""What attacks do to good requests: how long they wait, what memory stays, how long a stop takes.

The times are compared with those of the same service a moment before, so that what else the machine
does counts in both, and the median of some rounds is told.
"""

import tempfile
import time
from contextlib import suppress
from pathlib import Path
from statistics import median

import numpy as np

from rollcast import markdown
from tests.e2e.attacks import (
    ATTACKS,
    STOP_TIMEOUT_S,
    GoodRequests,
    Service,
    good_requests,
    one_model,
    repeated,
    started,
)

ROUNDS = 3
ROUND_S, LONGEST_ROUND_S = 4.0, 60.0
LEAST_ANSWERS = 50
MOST_TIMES = 3.0
MOST_GROWTH = 0.05
SETTLED_S = 20.0
STOP_MARGIN_S = 3.0
"""Seconds that a service may take beyond its stop timeout, as documented."""
PAUSE_S = 0.01
HEADER = markdown.header(
    (
        "attack, without a pause",
        "its requests",
        "good requests",
        "lost",
        "p99 without, ms",
        "p99 under attack, times that",
        "memory left behind",
        "SIGTERM meanwhile",
        "as promised",
    )
)


def main(only: list[str] | None) -> bool:
    """Try the attacks, print a row each; return whether all was as promised."""
    print(HEADER, flush=True)
    well = True
    with tempfile.TemporaryDirectory() as folder:
        models = one_model(Path(folder))
        with started(models) as service:
            with good_requests(service):  # what is used for the first time stays in memory
                for attack in ATTACKS.values():
                    with suppress(Exception):
                        attack(service)
            for name in ATTACKS:
                if only is None or any(word in name for word in only):
                    well = _row(name, service, _stop(models, name)) and well
    return well


def _row(name: str, service: Service, stop_s: float) -> bool:
    calm, times, asked, lost, attacks = [], [], 0, 0, 0
    rest = service.memory
    for _ in range(ROUNDS):
        with good_requests(service, PAUSE_S) as before:
            _wait(before)
        with repeated(service, name) as tried, good_requests(service, PAUSE_S) as under:
            _wait(under)
        attacks += len(tried)
        asked += len(before.seconds) + len(under.seconds)
        lost += len(before.lost) + len(under.lost)
        calm.append(float(np.percentile(before.seconds, 99)))
        times.append(float(np.percentile(under.seconds, 99)) / calm[-1])
    ends = time.monotonic() + SETTLED_S
    while (left := service.memory / rest - 1) > MOST_GROWTH and time.monotonic() < ends:
        time.sleep(0.1)
    well = (
        attacks > 0
        and not lost
        and median(times) <= MOST_TIMES
        and left <= MOST_GROWTH
        and stop_s <= STOP_TIMEOUT_S + STOP_MARGIN_S
    )
    cells = (
        name.replace("_", " "),
        attacks,
        asked,
        lost,
        f"{1000 * median(calm):.0f}",
        f"{median(times):.1f} ({min(times):.1f} .. {max(times):.1f})",
        f"{max(0, 100 * left):.1f} %",
        f"{stop_s:.1f} s",
        "yes" if well else "**no**",
    )
    print(markdown.row(cells), flush=True)
    return well


def _wait(good: GoodRequests) -> None:
    """Wait for a round: a machine that does other things answers less in its time."""
    ends = time.monotonic() + LONGEST_ROUND_S
    time.sleep(ROUND_S)
    while len(good.seconds) < LEAST_ANSWERS and time.monotonic() < ends:
        time.sleep(0.1)
    assert good.seconds, good.lost


def _stop(models: Path, name: str) -> float:
    """Return the seconds that a service takes to stop while an attack goes on."""
    with started(models) as service, repeated(service, name):
        time.sleep(2)
        service.process.terminate()
        began = time.monotonic()
        service.process.wait(60)
        return time.monotonic() - began
