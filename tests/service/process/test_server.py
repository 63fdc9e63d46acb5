"""A stop ends the process in time, whatever its threads compute."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from service.auth.api_keys import KeyFile

ROOT = Path(__file__).parents[3]
PROGRAM = """
import asyncio, socket, sys, threading
from pathlib import Path
from service.process.server import make_server
from service.settings import Settings
from tests.service import samples

def compute():
    while True:
        pass

def load(models_dir, name=None):
    if sys.argv[2] == "thread":
        threading.Thread(target=compute).start()
    if sys.argv[2] == "executor":
        asyncio.run_coroutine_threadsafe(asyncio.to_thread(compute), loop)
    if sys.argv[2] == "event loop":
        loop.call_soon_threadsafe(compute)
    print("computes", flush=True)
    return samples.registry(models_dir)

async def run():
    global loop
    loop = asyncio.get_running_loop()
    settings = Settings(models_dir=Path(sys.argv[1]), graceful_shutdown_timeout_s=1)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        await make_server(settings, load).serve([listener])

asyncio.run(run())
"""


@pytest.mark.parametrize("where", ["thread", "executor", "event loop"])
@pytest.mark.parametrize("order", [signal.SIGTERM, signal.SIGINT])
def test_a_computation_without_end_does_not_delay_a_stop(tmp_path, where, order):
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path), where],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "computes\n"
            process.send_signal(order)
            assert process.wait(30) in {1, -order}
        finally:
            process.kill()


def test_a_process_whose_app_cannot_start_ends(tmp_path):
    """The app has started threads before it misses its file of keys."""
    keys = tmp_path / "keys.json"
    KeyFile().write(keys)
    program = PROGRAM.replace(
        "graceful_shutdown_timeout_s=1)", "keys_file=sys.argv[3])\n    settings.keys_file.unlink()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path), "nothing", str(keys)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode in {1, 3}
    assert "keys.json" in done.stderr
