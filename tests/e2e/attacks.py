"""Attacks on a real server process, and the good requests that go on meanwhile.

``test_attacks.py`` tries each of them once; ``tests/faults/attacks.py`` measures what they cost.
"""

import base64
import contextlib
import functools
import gzip
import io
import json
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import psutil
from PIL import Image

from rollcast.client import Client
from tests.e2e.conftest import ROOT, start_service, wait_until_ready

MODEL = "fieldnet"
BUDGET = 64 * 2**20
STOP_TIMEOUT_S = 5
JSON = {"content-type": "application/json"}
SIMULATION = {"scenario": "heightfield", "seed": 1, "steps": 1000, "textured": True}


@dataclass
class Service:
    """A running service and what is asked of it."""

    address: str
    process: psutil.Process
    asked: Callable[[], None] = lambda: None
    """Called with every request and connection of an attack."""

    def post(self, path: str, content: bytes, timeout: float = 60, **headers: str) -> int:
        """Post a body; return the status, or 0 when there was no answer."""
        self.asked()
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        with contextlib.suppress(httpx2.HTTPError):
            return httpx2.post(
                f"{self.address}{path}", content=content, headers=JSON | named, timeout=timeout
            ).status_code
        return 0

    def connect(self) -> socket.socket:
        """Open a connection."""
        self.asked()
        parts = urlsplit(self.address)
        return socket.create_connection((parts.hostname, parts.port), timeout=30)

    @property
    def memory(self) -> int:
        """Resident bytes of the process and all that it has started."""
        total = 0
        for one in (self.process, *self.process.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                total += one.memory_info().rss
        return total


def frames_body(*images: bytes) -> bytes:
    return json.dumps({"frames": [base64.b64encode(image).decode() for image in images]}).encode()


@functools.cache
def progressive(side: int, scans: int) -> bytes:
    """A progressive JPEG file that repeats its last scan: half a kilobyte or two each time."""
    buffer = io.BytesIO()
    Image.new("RGB", (side, side), (90, 120, 60)).save(buffer, "JPEG", progressive=True)
    data = buffer.getvalue()
    last = data[data.rindex(b"\xff\xda") : -2]
    return data[:-2] + last * (scans - data.count(b"\xff\xda")) + b"\xff\xd9"


# --- Attacks: each returns the statuses that it has seen -----------------------------------------


def many_names(service: Service) -> list[int]:
    names = ", ".join(f'"n{index}": 1' for index in [*range(20_000), 0])
    body = f"{{{names}}}".encode()
    return [service.post(path, body) for path in ("/predict", "/simulate") for _ in range(3)]


def empty_lists(service: Service) -> list[int]:
    body = b"[" + b"[]," * 5_000_000 + b"[]]"
    paths = ("/predict", "/simulate", f"/v2/models/{MODEL}/infer")
    return [service.post(path, body) for path in paths]


def nested_lists(service: Service) -> list[int]:
    return [service.post("/predict", b"[" * 4_000_000) for _ in range(3)]


def unknown_fields(service: Service) -> list[int]:
    body = json.dumps({f"{index}{'x' * 7000}": "y" * 1000 for index in range(900)}).encode()
    service.asked()
    answer = httpx2.post(f"{service.address}/predict", content=body, headers=JSON, timeout=60)
    assert len(answer.content) < 10_000
    return [answer.status_code]


def wrong_velocities(service: Service) -> list[int]:
    scene = {"velocities_m_s": [["a", "b", "c"]] * 250_000}
    body = json.dumps({"scenario": "hemisphere", "seed": 1, "scene": scene}).encode()
    return [service.post("/simulate", body) for _ in range(3)]


def a_thousand_scans(service: Service) -> list[int]:
    return [service.post("/predict", frames_body(*[progressive(1024, 1000)] * 4))]


def slow_images_of_clients_that_leave(service: Service) -> list[int]:
    body = frames_body(*[progressive(4096, 30)] * 4)
    return [service.post("/predict", body, timeout=0.5) for _ in range(3)]


def many_chunks(service: Service) -> list[int]:
    buffer = io.BytesIO()
    Image.new("RGB", (128, 128)).save(buffer, "PNG")
    image = buffer.getvalue()
    chunk = b"\0\0\0\0abCd\x54\x01\xe6\x8d"
    return [service.post("/predict", frames_body(*[image[:33] + chunk * 200_000 + image[33:]] * 4))]


def many_parts(service: Service) -> list[int]:
    part = b'--b\r\nContent-Disposition: form-data; name="frames"\r\n\r\nx\r\n'
    kind = "multipart/form-data; boundary=b"
    return [service.post("/predict", part * 200_000, content_type=kind)]


def compressed_bomb(service: Service) -> list[int]:
    body = gzip.compress(bytes(50_000_000))
    return [service.post("/predict", body, content_encoding="gzip")]


def endless_trailers(service: Service) -> list[int]:
    head = (
        b"POST /predict HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n"
    )
    with service.connect() as connection:
        connection.sendall(head)
        with contextlib.suppress(OSError):
            for index in range(20_000):
                connection.sendall(b"x-%d: %s\r\n" % (index, b"y" * 10_000))
            raise AssertionError("the service has taken 200 MB of trailers")
    return []


def bodies_that_do_not_end(service: Service) -> list[int]:
    head = b"POST /predict HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
    piece = b" " * 2**20
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(service.connect()) for _ in range(16)]
        for connection in connections:
            connection.sendall(head + b"Content-Length: 60000000\r\n\r\n")
            connection.settimeout(2)
        before, most = service.memory, 0
        for _ in range(20):
            for connection in connections:
                with contextlib.suppress(OSError):  # it has been given up
                    connection.sendall(piece)
            most = max(most, service.memory)
        assert most - before < 3 * BUDGET
        time.sleep(0.5)
    return []


def simulations_of_clients_that_leave(service: Service) -> list[int]:
    body = json.dumps(SIMULATION).encode()
    for _ in range(4):
        service.post("/simulate", body, timeout=0.3)
    began = time.monotonic()
    small = json.dumps({"scenario": "hemisphere", "seed": 1, "steps": 4}).encode()
    status = service.post("/simulate", small)
    assert time.monotonic() - began < 60, "the simulations of clients that have left go on"
    return [] if status == 200 else [status]


def long_names(service: Service) -> list[int]:
    paths = [f"/v2/repository/models/{chr(97 + index) * 60_000}/load" for index in range(24)]
    with ThreadPoolExecutor(8) as pool:
        return list(pool.map(lambda path: service.post(path, b""), paths))


Attack = Callable[[Service], list[int]]
ATTACKS: dict[str, Attack] = {
    attack.__name__: attack
    for attack in (
        many_names,
        empty_lists,
        nested_lists,
        unknown_fields,
        wrong_velocities,
        a_thousand_scans,
        slow_images_of_clients_that_leave,
        many_chunks,
        many_parts,
        compressed_bomb,
        endless_trailers,
        bodies_that_do_not_end,
        simulations_of_clients_that_leave,
        long_names,
    )
}


@contextlib.contextmanager
def started(models: Path) -> Iterator[Service]:
    """Run a service of one process with small limits."""
    process, address = start_service(
        ROLLCAST_MODELS_DIR=str(models),
        ROLLCAST_PROCESSES="1",
        ROLLCAST_LOG_REQUESTS="false",
        ROLLCAST_MAX_TOTAL_BODY_BYTES=str(BUDGET),
        ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S=str(STOP_TIMEOUT_S),
    )
    try:
        with Client(address) as client:
            wait_until_ready(client)
        yield Service(address, psutil.Process(process.pid))
    finally:
        process.kill()
        process.communicate()


def one_model(folder: Path) -> Path:
    """Copy one model: a service with one starts sooner."""
    shutil.copytree(ROOT / "models" / MODEL, folder / MODEL)
    return folder


@dataclass
class GoodRequests:
    """What became of forecasts and of questions for health."""

    seconds: list[float] = field(default_factory=list[float])
    """Times of the forecasts that were answered."""
    lost: list[str] = field(default_factory=list[str])


@contextlib.contextmanager
def good_requests(service: Service, pause_s: float = 0.05) -> Iterator[GoodRequests]:
    """Ask for forecasts and health until the block is left."""
    ends, ended = GoodRequests(), threading.Event()

    def ask() -> None:
        with Client(service.address, retries=0, timeout_s=120) as client:
            frames = client.simulate("hemisphere", seed=3, steps=4).frames
            while not ended.wait(pause_s):
                began = time.monotonic()
                try:
                    client.predict(frames, horizon=5)
                    ends.seconds.append(time.monotonic() - began)
                except Exception as error:  # whatever it is, it is not an answer
                    ends.lost.append(repr(error))

    def look() -> None:
        while not ended.wait(pause_s):
            try:
                httpx2.get(f"{service.address}/health/live", timeout=10).raise_for_status()
            except httpx2.HTTPError as error:
                ends.lost.append(f"health: {error!r}")

    threads = [threading.Thread(target=target) for target in (ask, look)]
    for thread in threads:
        thread.start()
    try:
        yield ends
    finally:
        ended.set()
        for thread in threads:
            thread.join()


@contextlib.contextmanager
def repeated(service: Service, *names: str) -> Iterator[list[str]]:
    """Let attacks go on, each in a thread of another process, until the block is left.

    The process has a low priority: attackers compute on machines of their own. Yields a list
    that has an entry for every request in the end.
    """
    command = ["nice", "-n", "10", sys.executable, "-u", "-m", "tests.e2e.attacks"]
    attacker = subprocess.Popen(
        [*command, service.address, str(service.process.pid), *names],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert attacker.stdout is not None
    tried: list[str] = []
    begun = attacker.stdout.readline()
    assert begun == "begun\n"
    try:
        yield tried
    finally:
        attacker.kill()
        tried += attacker.communicate()[0].split()


def main() -> None:
    """Attack until killed."""
    address, pid, *names = sys.argv[1:]
    service = Service(address, psutil.Process(int(pid)), asked=lambda: print("asked"))

    def again(name: str) -> None:
        while True:
            with contextlib.suppress(Exception):
                ATTACKS[name](service)

    print("begun")
    for name in names:
        threading.Thread(target=again, args=(name,)).start()


if __name__ == "__main__":
    main()
