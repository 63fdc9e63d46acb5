"""Several worker processes on one listening socket, kept running by uvicorn's supervisor.

Every worker accepts connections and has its own models, threads and simulator. The supervisor
starts the workers, pings them, replaces workers that exit or do not respond, and stops them all in
a bounded time. Workers exchange no messages: a file lists loaded and unloaded models
(``service.serving.model_changes``), and memory-mapped files hold the metrics (decision 0132).
"""

import logging
import multiprocessing
import os
import shutil
import signal
import socket
import threading
import time
from contextlib import suppress
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

import uvicorn
from prometheus_client import Counter
from uvicorn.supervisors.multiprocess import SIGNALS, Multiprocess, Process

from service.observability.log_config import configuration
from service.observability.shared_metrics import reserve_metrics, write_metrics_as
from service.serving.model_changes import ModelChanges
from service.settings import SHUTDOWN_MARGIN_S, Settings, metrics_folder, share_metrics

RESPONSE_TIMEOUT_S = 10.0
"""Time after which a worker that does not answer a ping is replaced."""
START_TIMEOUT_S = 120.0
"""Time after which a worker that has not begun to accept connections is replaced."""
KILL_TIMEOUT_S = 1.0
"""Time for a killed process to disappear; one in uninterruptible sleep is left behind."""
POLL_S = 0.05
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)
SHARED_MEMORY = Path("/dev/shm")

log = logging.getLogger(__name__)


class Worker(Process):
    """One process that serves.

    Parameters
    ----------
    config
        Logging of the process until it has its settings.
    listener
        Socket that all workers accept from.
    settings
        Settings of the service; the worker takes its share.
    folder
        Folder that the workers share.
    name
        Name under which the worker writes metrics; its replacement takes it over.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        listener: socket.socket,
        settings: Settings,
        folder: Path,
        name: str,
    ) -> None:
        super().__init__(config, [listener])
        self.name = name
        self.has_started = False
        self._settings = settings
        self._folder = folder
        self._pinged_at: float | None = None
        self._created_at = time.monotonic()

    def target(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until told to stop; runs in the worker."""
        os.setpgrp()  # Ctrl-C goes to the supervisor alone, which tells each worker once
        threading.Thread(target=self._end_with_supervisor, daemon=True).start()
        write_metrics_as(self.name)
        changes = ModelChanges(self._folder)  # before models are loaded, which may change meanwhile
        # Imported here because the supervisor needs neither ONNX Runtime nor the app.
        from service.serving.loading import begin_loading

        load = begin_loading(self._settings.models_dir, self._settings.execution_provider)
        from service.process.server import make_server

        self._server = make_server(
            self._settings.share(), load, changes, on_start=lambda: self.child_conn.send(True)
        )
        super().target(sockets)

    def receive(self) -> None:
        """Read the messages of the worker: answers to pings, and its start."""
        with suppress(OSError, EOFError):
            while self.parent_conn.poll():
                self.has_started = self.parent_conn.recv() or self.has_started
                self._pinged_at = None

    def is_responsive(self) -> bool:
        """Return whether the last ping is answered or not yet due, without waiting."""
        now = time.monotonic()
        if not self.has_started:
            return now - self._created_at <= START_TIMEOUT_S
        if self._pinged_at is None:
            self._pinged_at = now
            with suppress(OSError):
                self.parent_conn.send(b"ping")
        return now - self._pinged_at <= RESPONSE_TIMEOUT_S

    def _end_with_supervisor(self) -> None:
        """Stop this worker when its supervisor is gone, which then has not removed the folder."""
        supervisor = multiprocessing.parent_process()
        assert supervisor is not None
        wait([supervisor.sentinel])
        shutil.rmtree(self._folder, ignore_errors=True)
        os.kill(os.getpid(), signal.SIGTERM)


class Supervisor(Multiprocess):
    """Keeps a number of workers running until SIGTERM or SIGINT.

    Parameters
    ----------
    settings
        Settings of the service.
    listener
        Socket that the workers accept from.
    folder
        Folder that the workers share.
    """

    def __init__(self, settings: Settings, listener: socket.socket, folder: Path) -> None:
        config = uvicorn.Config(
            "service.app:create_app",
            workers=settings.processes,
            log_config=configuration(settings.log_format, settings.log_requests),
        )
        super().__init__(config, [listener])
        for number in SIGNALS.keys() - set(STOP_SIGNALS):
            signal.signal(number, signal.SIG_DFL)  # uvicorn would start workers of its own class
        self.exit_code = 0
        self._settings = settings
        self._listener = listener
        self._folder = folder
        self._workers: list[Worker] = []
        self._has_served = False
        self._restarts = Counter(
            "rollcast_worker_restarts",
            "Replaced worker processes by reason",
            ["reason"],
        )
        for reason in ("exited", "unresponsive"):
            self._restarts.labels(reason)

    def init_processes(self) -> None:
        """Start all workers."""
        self._workers = [self._started(name) for name in worker_names(self._settings.processes)]

    def keep_subprocess_alive(self) -> None:
        """Replace workers that have ended or do not answer pings.

        A worker that ends before any worker has served ends the service: it would fail again.
        """
        for worker in self._workers:  # all of them, since one that has served decides for all
            worker.receive()
            self._has_served = self._has_served or worker.has_started
        for index, worker in enumerate(self._workers):
            alive = worker.process.is_alive()
            if alive and worker.is_responsive():
                continue
            worker.kill()
            worker.process.join(KILL_TIMEOUT_S)
            what = f"exited with {worker.exitcode}" if not alive else "did not answer a ping"
            if not self._has_served:
                log.error("worker %s %s before it served; stopping", worker.pid, what)
                self.exit_code = abs(worker.exitcode or 1)
                self.should_exit.set()
                return
            try:
                self._workers[index] = self._started(worker.name)
            except OSError:  # no memory or descriptors; the next check tries again
                log.exception("worker %s %s and cannot be replaced yet", worker.pid, what)
                continue
            log.error("worker %s %s; replaced by %s", worker.pid, what, self._workers[index].pid)
            self._restarts.labels("unresponsive" if alive else "exited").inc()

    def terminate_all(self) -> None:
        """Signal all workers to drain; a second signal skips waiting for requests."""
        for worker in self._workers:
            worker.process.terminate()

    def join_all(self) -> None:
        """Wait for the workers, for the stop timeout and a margin; then kill the remaining ones."""
        deadline = (
            time.monotonic() + self._settings.graceful_shutdown_timeout_s + 2 * SHUTDOWN_MARGIN_S
        )
        while (left := [one for one in self._workers if one.process.is_alive()]) and (
            time.monotonic() < deadline
        ):
            if self.signal_queue:
                self.signal_queue.clear()
                self.terminate_all()
            wait([one.process.sentinel for one in left], POLL_S)
        for worker in left:
            log.error("worker %s did not end in time and is killed", worker.pid)
            worker.kill()
        for worker in left:
            worker.process.join(KILL_TIMEOUT_S)

    def _started(self, name: str) -> Worker:
        worker = Worker(self.config, self._listener, self._settings, self._folder, name)
        worker.start()
        return worker


def supervise(settings: Settings, listener: socket.socket) -> int:
    """Serve with several workers until told to stop; return the exit code."""
    try:
        shared = _shared_folder(worker_names(settings.processes))
    except OSError as error:
        log.error("no room for the shared files of the worker processes: %s", error)
        return 1
    with shared as folder:
        supervisor = Supervisor(settings, listener, Path(folder))
        supervisor.run()
    return supervisor.exit_code


def worker_names(count: int) -> list[str]:
    """Return the names under which the workers of this process write metrics."""
    return [f"{os.getpid()}-{index}" for index in range(count)]


def _shared_folder(workers: list[str]) -> TemporaryDirectory[str]:
    """Make the folder that workers share, in shared memory or, without room there, on disk.

    Raises
    ------
    OSError
        When there is room in neither.
    """
    try:
        return _reserved_folder(SHARED_MEMORY, workers)
    except OSError:
        return _reserved_folder(Path(gettempdir()), workers)


def _reserved_folder(place: Path, workers: list[str]) -> TemporaryDirectory[str]:
    folder = TemporaryDirectory(prefix="rollcast-", dir=place)
    try:
        supervisor = str(os.getpid())
        metrics = metrics_folder() or Path(folder.name)
        reserve_metrics(metrics, supervisor, ["counter"])
        for worker in workers:
            reserve_metrics(metrics, worker)
        ModelChanges(Path(folder.name))
    except OSError:
        folder.cleanup()
        raise
    share_metrics(folder.name)
    write_metrics_as(supervisor)
    return folder
