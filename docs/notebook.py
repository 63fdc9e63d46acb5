"""``python -m docs.notebook``: execute the guide's notebook and keep its outputs.

A service is started for it. With ``--check`` nothing is written; it fails when a cell fails, or
when what a cell says is no longer what the notebook holds. Needs `.venv/tools` and `.venv/service`.
"""

import argparse
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from traitlets.config import Config

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / "docs/guide/forecast.ipynb"
ADDRESS = "http://127.0.0.1:8000"
"""What the notebook says; the service that is asked listens elsewhere."""
LONGEST_START_S = 120


def main() -> int:
    """Execute the notebook; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.notebook", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args().check
    held = nbformat.read(NOTEBOOK, as_version=4)
    with _serving() as address:
        made = _executed(held, address)
    if not check:
        nbformat.write(made, NOTEBOOK)
        return 0
    for old, new in zip(held.cells, made.cells, strict=True):
        if _said(old) != _said(new):
            print(
                f"{NOTEBOOK.name} has outdated outputs; run `python -m docs.notebook` to update "
                "them:\n"
                f"{_said(old)}\n{_said(new)}",
                file=sys.stderr,
            )
            return 1
    return 0


def _executed(notebook: nbformat.NotebookNode, address: str) -> nbformat.NotebookNode:
    asked = nbformat.from_dict(notebook)
    for cell in asked.cells:
        cell.source = cell.source.replace(ADDRESS, address)
    client = NotebookClient(
        asked,
        timeout=120,
        resources={"metadata": {"path": ROOT}},
        config=Config({"KernelManager": {"transport": "ipc"}}),
    )
    made = client.execute()
    for cell in made.cells:
        cell.source = cell.source.replace(address, ADDRESS)
        # When it was executed, and how long that took, would change with every execution.
        cell.metadata.pop("execution", None)
    made.metadata.language_info = {"name": "python"}
    return made


def _said(cell: nbformat.NotebookNode) -> list[str]:
    """Return the texts that a cell put out, and which pictures."""
    said: list[str] = []
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        if "image/png" in data:
            said.append("a picture")
        else:
            said.append(output.get("text") or data.get("text/plain", ""))
    return said


@contextmanager
def _serving() -> Iterator[str]:
    """Run the service on a free port; yield its address once it is ready."""
    command = [ROOT / ".venv/service/bin/python", "-m", "service", "--port", "0"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            found = re.search(r"http://\S+", process.stdout.readline())
            if found is None:
                raise RuntimeError("the service does not start; run `make serve` for the reason")
            _wait_until_ready(found.group())
            yield found.group()
        finally:
            process.terminate()


def _wait_until_ready(address: str) -> None:
    deadline = time.monotonic() + LONGEST_START_S
    while time.monotonic() < deadline:
        try:
            with urllib.request.urlopen(f"{address}/health/ready"):
                return
        except urllib.error.HTTPError:  # 503 while it loads
            time.sleep(0.1)
    raise TimeoutError(f"{address} is not ready after {LONGEST_START_S} s")


if __name__ == "__main__":
    sys.exit(main())
