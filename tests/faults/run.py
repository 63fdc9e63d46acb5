"""``make faults``: the real service under load while something goes wrong, several times each.

Prints a row a fault and one an attack, as in ``docs/reliability.md``; exits with 1 when a request
had no definite end, the service was not ready again by itself, or an attack cost good requests more
than is promised. Needs root for the full disk (a small tmpfs) and
Debian's libfaketime for the clock; without them the row says so.
"""

import argparse
import asyncio
import itertools
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import psutil

from rollcast import markdown
from rollcast.client import Client
from rollcast.manifest import ENCODER_FILE, ROLLOUT_FILE
from tests.bench.harness import answering, service
from tests.bench.loop import MODEL, ROOT
from tests.e2e.conftest import start_service, wait_until_ready
from tests.faults import attacks
from tests.faults.load import HEADER, READY_WITHIN_S, Load, Report

Fault = Callable[[Report, int], Awaitable[None]]
FAKETIME = Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1")
NEW_PROCESS_S = 8
"""Until a process that replaces another has its models, beside the load."""
LOST = frozenset({"503 simulation-lost"})
FULL = frozenset({"429 queue-full"})
CLOSED = frozenset({"connection closed"})
STOPPING = CLOSED | {"503 not-ready", "503", "nobody listens"}
"""/v2 has no names for its refusals; what still waits for a listener that closes is closed."""


class SkippedError(Exception):
    """This machine cannot do it."""


async def killed_process(report: Report, times: int) -> None:
    """kill -9 of one of two workers: its connections end, the other one continues."""
    report.expected = LOST | CLOSED
    with service(ROLLCAST_PROCESSES="2") as (address, process):
        load = Load(address, report)
        async with load.running():
            for _ in range(times):
                await asyncio.sleep(1)
                before = answering(process)
                before[0].kill()
                await load.until_ready()
                # The next one would take the last that forecasts, were the new one not there yet.
                await asyncio.sleep(NEW_PROCESS_S)


async def killed_simulation(report: Report, times: int) -> None:
    """kill -9 of the process that simulates, in the middle of a simulation."""
    report.expected = LOST
    with service() as (address, process):
        load = Load(address, report)
        async with load.running():
            for _ in range(times):
                await asyncio.sleep(1)
                for child in simulating(process):
                    child.kill()
                await load.until_ready()


async def told_to_stop(report: Report, times: int) -> None:
    """SIGTERM: what was accepted is answered, what comes later is refused or finds nobody."""
    report.expected = STOPPING
    for _ in range(times):
        process, address = start_service()
        with Client(address) as client:
            wait_until_ready(client)
        load = Load(address, report)
        async with load.running():
            await asyncio.sleep(2)
            process.terminate()
            begun = time.monotonic()
            await asyncio.to_thread(process.communicate, timeout=30)
            report.ready_after_s.append(min(time.monotonic() - begun, READY_WITHIN_S))


async def full_disk(report: Report, times: int) -> None:
    """No byte is left where logs and temporary files go; frames come in parts of a megabyte."""
    with small_disk() as disk, (disk / "log").open("w") as log:
        process, address = start_service(log, TMPDIR=str(disk))
        with Client(address) as client:
            wait_until_ready(client)
        fill(disk)
        # Nor is there room on any other disk that a program might turn to.
        for one in answering(psutil.Process(process.pid)):
            resource.prlimit(one.pid, resource.RLIMIT_FSIZE, (0, 0))
        load = Load(address, report)
        async with load.running():
            for _ in range(times):
                await asyncio.sleep(1)
                status = await asyncio.to_thread(large_parts, address)
                report.ends[str(status)] += 1
                await load.until_ready()
        process.terminate()
        process.wait(30)


async def changed_models(report: Report, times: int) -> None:
    """Graphs are cut off, swapped or taken away while their model is loaded again and again."""
    with tempfile.TemporaryDirectory() as scratch:
        models = Path(scratch) / "models"
        for name in (MODEL, "posnet"):
            shutil.copytree(ROOT / "models" / name, models / name)
        folder = models / MODEL / "1"
        with service(ROLLCAST_MODELS_DIR=str(models)) as (address, _):
            load = Load(address, report)
            async with load.running():
                for change in itertools.islice(itertools.cycle(CHANGES), times):
                    await asyncio.to_thread(change_and_load, address, folder, change)
                    await load.until_ready()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def swap(path: Path) -> None:
    shutil.copy(ROOT / "models/posnet/1" / path.name, path)


CHANGES = (cut, empty, swap, Path.unlink)


def change_and_load(address: str, folder: Path, change: Callable[[Path], None]) -> None:
    """Change a file before and while its model is loaded: that is told, and mended by the next."""
    path = folder / (ROLLOUT_FILE if change is not cut else ENCODER_FILE)
    whole = path.read_bytes()
    load = f"{address}/v2/repository/models/{MODEL}/load"
    change(path)
    told = httpx2.post(load, timeout=60)
    assert told.status_code == 400, told.text
    path.write_bytes(whole)
    with subprocess.Popen(
        ["curl", "--silent", "--output", "/dev/null", "--request", "POST", load]
    ) as loading:
        while loading.poll() is None:  # it reads the file somewhere in between
            change(path)
            time.sleep(0.002)
            path.write_bytes(whole)
            time.sleep(0.002)
    told = httpx2.post(load, timeout=60)
    assert told.status_code == 200, told.text


async def clock_steps(report: Report, times: int) -> None:
    """The clock of the day jumps by an hour, a day and ten years, forth and back."""
    if not FAKETIME.exists():
        raise SkippedError("libfaketime is not there")
    with tempfile.TemporaryDirectory() as scratch:
        offset = Path(scratch) / "offset"
        offset.write_text("+0")
        clock = {
            "LD_PRELOAD": str(FAKETIME),
            "FAKETIME_TIMESTAMP_FILE": str(offset),
            "FAKETIME_CACHE_DURATION": "1",
            "DONT_FAKE_MONOTONIC": "1",
        }
        with service(**clock) as (address, _):
            load = Load(address, report)
            async with load.running():
                await load.until_ready()
                report.ready_after_s.clear()  # that was the start, not the fault
                for step in itertools.islice(itertools.cycle(STEPS), times):
                    offset.write_text(step)
                    await asyncio.sleep(1.1)  # until it has been read
                    await load.until_ready()
                    said = await asyncio.to_thread(lambda: httpx2.get(address).headers["date"])
                    if step in {"+10y", "-10y"}:
                        report.ends[f"year {said.split()[3]}"] += 1
                    await asyncio.sleep(1)
        report.expected = frozenset(end for end in report.ends if end.startswith("year"))


STEPS = ("+1h", "-1h", "+1d", "-1d", "+10y", "-10y", "+0")


async def no_descriptors(report: Report, times: int) -> None:
    """Idle connections take every descriptor that the process may have, simulations one too."""
    report.expected = CLOSED | LOST
    with service(ROLLCAST_READ_TIMEOUT_S="2") as (address, process):
        load = Load(address, report)
        async with load.running():
            for _ in range(times):
                await asyncio.sleep(1)
                for one in [process, *answering(process)]:
                    limit, (_, most) = one.num_fds() + 20, one.rlimit(resource.RLIMIT_NOFILE)
                    one.rlimit(resource.RLIMIT_NOFILE, (limit, most))
                with ExitStack() as idle:
                    for _ in range(60):
                        idle.enter_context(socket.create_connection(parts(address), timeout=5))
                    for child in simulating(process):
                        child.kill()
                    await asyncio.sleep(3)
                    await load.until_ready()


async def no_memory(report: Report, times: int) -> None:
    """Large frames are sent to a service whose memory is at its limit.

    Where not even a problem document can be made, Uvicorn answers with 500 or 400 in plain text, or
    closes the connection.
    """
    report.expected = LOST | CLOSED | {"503 out-of-memory", "400", "500"}
    with service() as (address, process):
        load = Load(address, report)
        async with load.running():
            await asyncio.sleep(3)
            for _ in range(times):
                for one in answering(process):
                    room = one.memory_info().vms + 48 * 2**20
                    resource.prlimit(one.pid, resource.RLIMIT_AS, (room, resource.RLIM_INFINITY))
                status = await asyncio.to_thread(large_frames, address)
                report.ends[status] += 1
                for one in answering(process):
                    resource.prlimit(one.pid, resource.RLIMIT_AS, 2 * (resource.RLIM_INFINITY,))
                await load.until_ready()


async def deaf_clients(report: Report, times: int) -> None:
    """Clients ask for long answers and never read them; they are given up, and their memory."""
    with service(ROLLCAST_WRITE_TIMEOUT_S="2") as (address, process):
        load = Load(address, report)
        async with load.running():
            await asyncio.sleep(3)
            before = descriptors(process)
            for _ in range(times):
                with ExitStack() as deaf:
                    for _ in range(5):
                        client = deaf.enter_context(socket.socket())
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                        client.connect(parts(address))
                        client.sendall(long_simulation())
                    await asyncio.sleep(6)
                    await load.until_ready()
            left_behind(process, before)


async def slow_senders(report: Report, times: int) -> None:
    """Clients send a byte a second; they are given up."""
    with service(ROLLCAST_READ_TIMEOUT_S="2") as (address, process):
        load = Load(address, report)
        async with load.running():
            await asyncio.sleep(3)
            before = descriptors(process)
            for _ in range(times):
                with ExitStack() as slow:
                    clients = [
                        slow.enter_context(socket.create_connection(parts(address), timeout=5))
                        for _ in range(50)
                    ]
                    for piece in (b"POST /predict HTTP/1.1\r\nContent-Le", b"ngth: 9", b"9", b"9"):
                        send_to_whom_listens(clients, piece)
                        await asyncio.sleep(1)
                    await load.until_ready()
                    left_behind(process, before)


def left_behind(process: psutil.Process, before: int) -> None:
    """Check that the connections of clients that are still there have been closed."""
    held = descriptors(process)
    if held > before + 4:
        raise AssertionError(f"{held} descriptors, {before} before")


def descriptors(process: psutil.Process) -> int:
    """Descriptors that the processes that answer have open."""
    return sum(one.num_fds() for one in answering(process))


def send_to_whom_listens(clients: list[socket.socket], piece: bytes) -> None:
    for client in clients:
        try:
            client.sendall(piece)
        except ConnectionError:
            continue


def parts(address: str) -> tuple[str, int]:
    """Host and port."""
    split = urlsplit(address)
    return str(split.hostname), int(split.port or 80)


def simulating(process: psutil.Process) -> list[psutil.Process]:
    """The processes that simulate and are alive."""
    found: list[psutil.Process] = []
    for child in process.children(recursive=True):
        with suppress(psutil.Error):
            found += [child] if "spawn_main" in " ".join(child.cmdline()) else []
    return found


def large_parts(address: str) -> int:
    """Post frames that Starlette would put into temporary files."""
    content = noise(1024)
    files = [("frames", ("frame.png", content)) for _ in range(4)]
    return httpx2.post(f"{address}/predict", files=files, timeout=60).status_code


def large_frames(address: str) -> str:
    """Post the largest frames that there are, noise that hardly compresses."""
    content = flat(4096)
    files = [("frames", ("frame.png", content)) for _ in range(4)]
    try:
        answer = httpx2.post(f"{address}/predict", files=files, timeout=60)
    except httpx2.TransportError:
        return "connection closed"
    if answer.status_code == 200:
        return "200"
    return f"{answer.status_code} {answer.json()['type'].removeprefix('/problems/')}"


def noise(side: int) -> bytes:
    """A PNG of more than three bytes a pixel."""
    import io

    import numpy as np
    from PIL import Image

    pixels = np.random.default_rng(1).integers(0, 256, (side, side, 3), np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=0)
    return buffer.getvalue()


def flat(side: int) -> bytes:
    """A large PNG in few bytes."""
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", (side, side), (90, 90, 90)).save(buffer, "PNG")
    return buffer.getvalue()


def long_simulation() -> bytes:
    """A request whose answer is some megabytes."""
    body = b'{"scenario": "ellipsoid", "seed": 7, "steps": 40, "image_size": 256}'
    return (
        b"POST /simulate HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n\r\n%b" % (len(body), body)
    )


@contextmanager
def small_disk() -> Iterator[Path]:
    """A file system of a megabyte."""
    with tempfile.TemporaryDirectory() as scratch:
        mounted = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", scratch]
        if subprocess.run(mounted, capture_output=True, check=False).returncode != 0:
            raise SkippedError("mounting a tmpfs needs root")
        try:
            yield Path(scratch)
        finally:
            subprocess.run(["umount", "--lazy", scratch], check=True)


def fill(disk: Path) -> None:
    """Write until nothing more fits."""
    try:
        with (disk / "filler").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass
    except OSError:
        return


FAULTS: dict[str, tuple[Fault, int]] = {
    "kill -9 of one of two workers": (killed_process, 5),
    "kill -9 of the process that simulates": (killed_simulation, 10),
    "SIGTERM": (told_to_stop, 3),
    "full disk": (full_disk, 5),
    "model files cut, emptied, swapped, removed": (changed_models, 12),
    "clock steps": (clock_steps, 7),
    "no descriptors left": (no_descriptors, 3),
    "memory at its limit": (no_memory, 5),
    "clients that never read": (deaf_clients, 3),
    "slow senders": (slow_senders, 3),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="WORD", help="those with one of these words")
    parser.add_argument("--table", choices=("faults", "attacks"), help="one of the two tables")
    given = parser.parse_args()
    well = [_faults(given.only)] if given.table != "attacks" else []
    well += [attacks.main(given.only)] if given.table != "faults" else []
    return 0 if all(well) else 1


def _faults(only: list[str] | None) -> bool:
    print(HEADER, flush=True)
    well = True
    for name, (fault, times) in FAULTS.items():
        if only and not any(word in name for word in only):
            continue
        report = Report(name)
        try:
            asyncio.run(fault(report, times))
        except SkippedError as error:
            print(markdown.row((name, *"---", f"not tried: {error}", *"--")), flush=True)
            continue
        print(report.row(), flush=True)
        well = well and report.well
    return well


if __name__ == "__main__":
    sys.exit(main())
