"""A user's folder: a checkout, a video, four frames, and a service that answers."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.client import Client
from tests.docs.blocks import ROOT
from tests.e2e.conftest import serving

ASKING = "predict|live|simulate|track|models|doctor"
"""Commands of rollcast that ask a service."""
CHECKOUT = (".venv", "docs", "models", "rollcast", "service", "tools", "training")


@pytest.fixture(scope="session")
def address(request) -> Iterator[str]:
    if (given := request.config.getoption("--address")) is not None:
        yield given
        return
    with serving() as address:
        yield address


@pytest.fixture(scope="session")
def footage(address, tmp_path_factory) -> Path:
    """A clip of 4 s, 680 x 480, and its first four frames cut out."""
    folder = tmp_path_factory.mktemp("footage")
    with Client(address) as client:
        seen = client.simulate("hemisphere", seed=7, steps=160, image_size=240).frames
    frames = np.pad(seen.repeat(2, axis=1).repeat(2, axis=2), ((0, 0), (0, 0), (100, 100), (0, 0)))
    with av.open(folder / "clip.mp4", "w") as container:
        stream = container.add_stream("libx264", rate=40)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    for index, frame in enumerate(seen[:4]):
        Image.fromarray(frame).save(folder / f"frame{index}.png")
    return folder


@pytest.fixture
def folder(footage, tmp_path) -> Path:
    """Where a block runs: as in the root of a checkout, beside the user's own files."""
    for file in (*footage.iterdir(), *(ROOT / name for name in CHECKOUT)):
        (tmp_path / file.name).symlink_to(file)
    return tmp_path


@pytest.fixture(scope="session")
def environment(address, tmp_path_factory) -> dict[str, str]:
    """Variables of a shell that knows rollcast and the service's address."""
    commands = tmp_path_factory.mktemp("bin")
    for name in ("python", "python3"):
        _write_command(commands / name, f'exec "{sys.executable}" "$@"')
    _write_command(
        commands / "rollcast",
        f'case "$1" in {ASKING}) set -- "$@" --url {address};; esac\nexec python -m rollcast "$@"',
    )
    return {
        **os.environ,  # noqa: TID251 - a user's shell
        "PATH": f"{commands}:/usr/bin:/bin",
        "PYTHONPATH": str(ROOT),
        "PYTHONWARNINGS": "error",
        "MPLBACKEND": "Agg",
    }


def _write_command(path: Path, script: str) -> None:
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
