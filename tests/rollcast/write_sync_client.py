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
CLIENT = ROOT / "rollcast/client"
TARGETS = {
    CLIENT / "sync.py": CLIENT / "aio.py",
    CLIENT / "sync_session.py": CLIENT / "aio_session.py",
}
"""Files that are written, and their sources."""
HEADER = """\
# Written by `python -m tests.rollcast.write_sync_client` (`make format`).
# The source is {source}: change that.
"""
RENAMED = {
    "AsyncBaseTransport": "BaseTransport",
    "AsyncClient": "Client",
    "AsyncForecastStream": "ForecastStream",
    "AsyncGenerator": "Generator",
    "AsyncSession": "Session",
    "aclose": "close",
    "aio_session": "sync_session",
    "aiter": "iter",
    "aiter_bytes": "iter_bytes",
    "_async": "_sync",
}


def sync_client(target: Path) -> str:
    """Return what a committed file has to be."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / TARGETS[target].name
        shutil.copy(TARGETS[target], source)
        unasync.unasync_files([str(source)], [unasync.Rule(source.name, target.name, RENAMED)])
        text = source.with_name(target.name).read_text()
    # What it leaves alone: names in quotes and comments.
    for name, other in RENAMED.items():
        text = re.sub(rf"\b{name}\b", other, text)
    text = HEADER.format(source=source.name) + re.sub(r"\b(async|await) ", "", text)
    for command in (["check", "--fix", "--quiet", "--select", "I,SIM117"], ["format"]):
        text = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--stdin-filename", target, "-"],
            input=text,
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        ).stdout
    return text


if __name__ == "__main__":
    for target in TARGETS:
        target.write_text(sync_client(target))
