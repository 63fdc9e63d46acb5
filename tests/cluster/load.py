"""Clients that ask without a pause, while something happens to the service."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import httpx2
import numpy as np

from rollcast.client import Client, Simulation
from rollcast.schemas import REPLICA_HEADER, REQUEST_ID_HEADER
from tests.cluster.nodes import wait_until

MODEL = "fieldnet"
RETRIES = 8
LARGEST_DIFFERENCE_PX = 1e-2


@dataclass(frozen=True)
class Asked:
    """Frames, and the forecast that must come back."""

    frames: np.ndarray
    positions: np.ndarray


@dataclass(frozen=True)
class Answer:
    """A call that was answered."""

    begun: float
    seconds: float
    version: int
    difference_px: float


@dataclass
class Phase:
    """What was answered while something happened."""

    name: str
    answers: list[Answer] = field(default_factory=list[Answer])

    def quantile_ms(self, share: float) -> float:
        """Milliseconds within which so many of the calls were answered, their retries included."""
        return 1e3 * float(np.quantile([one.seconds for one in self.answers], share))

    @property
    def largest_difference_px(self) -> float:
        """From what the checkout answers."""
        return max(one.difference_px for one in self.answers)


class Noted(httpx2.HTTPTransport):
    """Notes of every forecast that came who answered it, by the request's id."""

    def __init__(self) -> None:
        super().__init__()
        self.attempts: Counter[str] = Counter()
        self.answered_by: dict[str, list[str]] = {}

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        request_id = request.headers[REQUEST_ID_HEADER]
        self.attempts[request_id] += 1
        response = super().handle_request(request)
        if response.status_code == 200:
            replicas = self.answered_by.setdefault(request_id, [])
            replicas.append(response.headers.get(REPLICA_HEADER, ""))
        return response


class Load:
    """Some clients, each with one request at a time on its way."""

    def __init__(self, address: str, asked: Sequence[Asked], clients: int) -> None:
        self._address = address
        self._asked = asked
        self._over = threading.Event()
        self._lock = threading.Lock()
        self.answers: list[Answer] = []
        self.failures: list[Exception] = []
        self.transports = [Noted() for _ in range(clients)]
        self._threads = [
            threading.Thread(target=self._ask_on, args=(transport,))
            for transport in self.transports
        ]

    def __enter__(self) -> "Load":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    @contextmanager
    def phase(self, name: str) -> Iterator[Phase]:
        """Gather the calls that were under way at any time of a ``with`` block."""
        begun = time.monotonic()
        phase = Phase(name)
        yield phase
        with self._lock:
            phase.answers = [one for one in self.answers if one.begun + one.seconds >= begun]

    def wait_for(self, answers: int) -> None:
        """Wait until so many more calls are answered."""
        wanted = len(self.answers) + answers
        wait_until(lambda: len(self.answers) >= wanted)

    @property
    def accepted(self) -> int:
        """Calls that were answered."""
        return len(self.answers)

    @property
    def retried(self) -> int:
        """Calls that were answered after more than one attempt."""
        return sum(n > 1 for one in self.transports for n in one.attempts.values())

    @property
    def answered_by(self) -> dict[str, list[str]]:
        """The replicas whose answers came, by the call's id."""
        return {key: names for one in self.transports for key, names in one.answered_by.items()}

    def _ask_on(self, transport: Noted) -> None:
        with Client(self._address, transport=transport, retries=RETRIES) as client:
            number = 0
            while not self._over.is_set():
                asked = self._asked[number % len(self._asked)]
                number += 1
                begun = time.monotonic()
                try:
                    forecast = client.predict(asked.frames, model=MODEL)
                except Exception as error:  # told by the test
                    self.failures.append(error)
                    continue
                seconds = time.monotonic() - begun
                difference = float(np.abs(forecast.positions - asked.positions).max())
                with self._lock:
                    self.answers.append(Answer(begun, seconds, forecast.model.version, difference))


def questions(address: str, seeds: range) -> list[Asked]:
    """Scenes with the forecasts of the service at an address."""
    with Client(address) as client:
        scenes: list[Simulation] = [client.simulate("hemisphere", seed=seed) for seed in seeds]
        return [
            Asked(scene.frames[:4], client.predict(scene.frames[:4], model=MODEL).positions)
            for scene in scenes
        ]
