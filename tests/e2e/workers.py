"""A real service of one or several processes, its workers, its log and its metrics."""

import re
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Self

import httpx2
import psutil

from rollcast.client import Client
from tests.bench.harness import answering
from tests.e2e.conftest import ROOT, start_service, wait_until_ready

MODEL = "posnet"
STOP_TIMEOUT_S = 4
"""Of the services here: what SIGTERM may take, beside a margin."""
STOP_MARGIN_S = 6
"""Documented are three seconds; the others are for a busy machine."""


class Service:
    """A service of some processes.

    Parameters
    ----------
    processes
        Worker processes.
    wait
        Whether to wait for its models.
    prefix
        A command that runs the service.
    only
        The model that it has, which starts sooner; None for all committed models.
    settings
        Variables of the service's environment.
    """

    def __init__(
        self,
        processes: int,
        *,
        wait: bool = True,
        prefix: Sequence[str] = (),
        only: str | None = None,
        **settings: str,
    ) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._log = Path(self._folder.name) / "log"
        variables = {
            "ROLLCAST_PROCESSES": str(processes),
            "ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S": str(STOP_TIMEOUT_S),
        }
        if only is not None:
            models = Path(self._folder.name) / "models"
            shutil.copytree(ROOT / "models" / only, models / only)
            variables["ROLLCAST_MODELS_DIR"] = str(models)
        with self._log.open("a") as log:
            self.popen, self.address = start_service(log, prefix=prefix, **variables | settings)
        self.process = psutil.Process(self.popen.pid)
        self._processes = processes
        if wait:
            with Client(self.address) as client:
                wait_until_ready(client)
            wait_for(lambda: len(self.workers()) == processes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Stop in time, whatever state its processes are in; a failed test shows the log."""
        if kind is not None:
            print(self.log())
        everything = []
        with suppress(psutil.NoSuchProcess):
            everything = [self.process, *self.process.children(recursive=True)]
        try:
            if self.popen.poll() is None:
                self.stop()
        finally:
            for process in everything:
                with suppress(psutil.NoSuchProcess):
                    process.kill()
            self.popen.communicate()
            self._folder.cleanup()

    def stop(self) -> None:
        """Send SIGTERM; all processes end in time."""
        everything = [self.process, *self.process.children(recursive=True)]
        begun = time.monotonic()
        self.popen.terminate()
        self.popen.communicate(timeout=60)
        assert time.monotonic() - begun < STOP_TIMEOUT_S + STOP_MARGIN_S
        _, left = psutil.wait_procs(everything, STOP_MARGIN_S)
        assert not left

    def workers(self) -> list[psutil.Process]:
        """Processes that accept connections."""
        found = answering(self.process)
        return found if self._processes == 1 or found != [self.process] else []

    def log(self) -> str:
        """Everything that the service has logged."""
        return self._log.read_text("utf-8")

    def metrics(self) -> str:
        """All metrics."""
        return httpx2.get(f"{self.address}/metrics", timeout=60).text

    def metric(self, pattern: str) -> list[float]:
        """Values of the metrics whose name and labels match."""
        found = re.findall(rf"^{pattern} (\S+)", self.metrics(), re.MULTILINE)
        return [float(value) for value in found]

    def recorded_changes(self) -> dict[str, str]:
        """The last changes of models that the workers follow."""
        (path,) = Path("/dev/shm").glob(f"rollcast-*/counter_{self.popen.pid}.db")
        return {one.name: one.read_text("utf-8") for one in (path.parent / "changes").iterdir()}


def wait_for(condition: Callable[[], bool], seconds: float = 90) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def connect_to_each(service: Service, stack: ExitStack) -> list[httpx2.Client]:
    """Return clients whose open connections are held by one worker each."""
    found: dict[int, httpx2.Client] = {}
    wanted = {worker.pid for worker in service.workers()}

    def connect() -> bool:
        client = stack.enter_context(httpx2.Client(base_url=service.address, timeout=60))
        with client.stream("GET", "/health/live") as response:
            stream = response.extensions["network_stream"]
            port = stream.get_extra_info("client_addr")[1]
            response.read()
        for worker in service.workers():
            ports = {one.raddr.port for one in worker.net_connections("tcp") if one.raddr}
            if port in ports:
                found.setdefault(worker.pid, client)
        return found.keys() == wanted

    wait_for(connect)
    return [found[pid] for pid in sorted(found)]


def change(client: httpx2.Client, what: str, name: str = MODEL) -> int:
    """Load or unload a model; return the status of the answer."""
    return client.post(f"/v2/repository/models/{name}/{what}").status_code


def statuses(clients: list[httpx2.Client]) -> set[str]:
    """Status of the model as each connection tells it."""
    return {client.get(f"/models/{MODEL}/versions/1").json()["status"] for client in clients}
