"""Code blocks of the documents: which there are, and which of them cannot run in a test."""

import json
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs/guide"
PAGES = (ROOT / "README.md", ROOT / "docs/index.md", *sorted(GUIDE.glob("*.md")))
NOTEBOOK = GUIDE / "forecast.ipynb"

INDEX = "needs the package index"
SERVER = "is the server that the other blocks ask"
DOCKER = "needs a Docker engine; make image-test builds and runs the images"
CLUSTER = "needs a cluster; make image-test judges the manifests, make cluster-test runs Ray"
TRACKS = "tracks three clips for minutes; tests/rollcast/tracking does so with small ones"
TRAINED = (
    "needs a model that was trained on clips; tests/training/export/test_footage.py serves one"
)
HOURS = "works for minutes to days; its arguments are parsed"
MAKES = "makes environments, then runs for minutes"

NOT_RUN = {
    ("start.md", "git clone ADDRESS_OF_THIS_REPOSITORY rollcast"): MAKES,
    ("start.md", "python3.11 -m venv .venv/client"): INDEX,
    ("api-python.md", "pip install .                                # the client"): INDEX,
    ("deployment.md", "make serve"): SERVER,
    ("deployment.md", "export ROLLCAST_KEYS_FILE=keys.json"): SERVER,
    (
        "deployment.md",
        "docker build -f docker/service.Dockerfile -t rollcast-service:0.1.0 .",
    ): DOCKER,
    ("deployment.md", "mkdir keys"): DOCKER,
    ("deployment.md", "kind load docker-image rollcast-service:0.1.0"): CLUSTER,
    (
        "deployment.md",
        "docker tag rollcast-service:0.1.0 registry.example/rollcast-service:0.1.0",
    ): CLUSTER,
    ("deployment.md", "serve run service.process.ray_serve:application"): CLUSTER,
    ("research.md", "python -m training simulate hemisphere --scenes 1000 --split training"): HOURS,
    (
        "research.md",
        "python -m training evaluate --all        # docs/results: tables, curves, ellipses",
    ): HOURS,
    ("research.md", "python -m training train tiny"): SERVER,
    ("research.md", "python -m training train field-one-ball"): HOURS,
    (
        "setup.md",
        "rollcast track setup/clip1.mp4 setup/clip2.mp4 setup/clip3.mp4 --balls 2 --out setup",
    ): TRACKS,
    (
        "setup.md",
        "python -m training train setup-2-balls --data setup --init models/fieldnet-2/1",
    ): HOURS,
    (
        "setup.md",
        "python -m training train setup-2-balls-seeing --data setup --init runs/setup-2-balls",
    ): HOURS,
    ("setup.md", "python -m training setup setup-2-balls-continued --data setup"): HOURS,
    ("setup.md", "rollcast predict clip3.mp4 --start 2 --model table --out forecast.mp4"): TRAINED,
    (
        "setup.md",
        "from rollcast.client import Client",
    ): TRAINED,
}
"""By page and first line. Nothing else is left out."""


class Block(NamedTuple):
    """A fenced block of code."""

    page: str
    line: int
    """Of the page, from 1."""
    language: str
    text: str

    @property
    def key(self) -> tuple[str, str]:
        """How NOT_RUN names it."""
        return self.page, self.text.splitlines()[0]

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks() -> list[Block]:
    """Every block of every page that shows code; directives are the site's own affair."""
    return [
        Block(page.name, token.map[0] + 1, token.info.strip(), token.content)
        for page in PAGES
        for token in MarkdownIt().parse(page.read_text(encoding="utf-8"))
        if token.type == "fence" and token.map and not token.info.startswith("{")
    ]


def notebook_code() -> str:
    """All of the notebook's code."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
