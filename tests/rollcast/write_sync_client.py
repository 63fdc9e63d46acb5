"""Write the client that blocks out of the one that is awaited.

python -m tests.rollcast.write_sync_client
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import unasync

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "rollcast/client/aio.py"
TARGET = SOURCE.with_name("sync.py")
HEADER = """\
# Written by `python -m tests.rollcast.write_sync_client` (`make format`) from aio.py: change that.
"""
RENAMED = {
    "AsyncBaseTransport": "BaseTransport",
    "AsyncClient": "Client",
    "AsyncForecastStream": "ForecastStream",
    "AsyncGenerator": "Generator",
    "aclose": "close",
    "aiter": "iter",
    "aiter_bytes": "iter_bytes",
    "_async": "_sync",
}


def sync_client() -> str:
    """Return what the committed file has to be."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "aio.py"
        shutil.copy(SOURCE, source)
        unasync.unasync_files([str(source)], [unasync.Rule("aio.py", "sync.py", RENAMED)])
        text = source.with_name("sync.py").read_text()
    # What it leaves alone: names in quotes and comments.
    for name, other in RENAMED.items():
        text = re.sub(rf"\b{name}\b", other, text)
    text = HEADER + re.sub(r"\b(async|await) ", "", text)
    for command in (["check", "--fix", "--quiet", "--select", "I,SIM117"], ["format"]):
        text = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--stdin-filename", TARGET, "-"],
            input=text,
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        ).stdout
    return text


if __name__ == "__main__":
    TARGET.write_text(sync_client())
