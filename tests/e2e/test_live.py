"""``rollcast live`` as its users call it: a process, a clip played as if live, the real service."""

import io
import re
import socket
import subprocess
import sys
from pathlib import Path

import av
import httpx2
import numpy as np
from PIL import Image

from tests.e2e.conftest import ROOT

FRAMES = 120


def write_clip(path: Path) -> Path:
    """A red disc that rolls to the right."""
    rows, columns = np.indices((120, 160)) + 0.5
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=20)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        for index in range(FRAMES):
            picture = np.full((120, 160, 3), 90, np.uint8)
            picture[np.hypot(columns - 20 - index, rows - 60) < 8] = (220, 60, 50)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_a_clip_is_forecast_while_it_plays(address, tmp_path):
    clip = write_clip(tmp_path / "clip.mp4")
    command = [sys.executable, "-m", "rollcast", "live", str(clip), "--url", address]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stderr is not None
        page = re.search(r"http://127\.0\.0\.1:\d+/", run.stderr.readline())
        assert page
        assert "stream.mjpg" in httpx2.get(page.group()).text
        body = b""
        with httpx2.stream("GET", f"{page.group()}stream.mjpg", timeout=60) as pictures:
            assert pictures.headers["content-type"].startswith("multipart/x-mixed-replace")
            for part in pictures.iter_bytes():
                body += part
        said, warned = run.communicate(timeout=60)
    assert (run.returncode, warned) == (0, "")
    shown = [one.partition(b"\r\n\r\n")[2] for one in body.split(b"--frame\r\n")[1:]]
    assert shown
    with Image.open(io.BytesIO(shown[0])) as picture:
        assert max(picture.size) == 480
    told = re.search(r"(\d+) frames, (\d+) forecasts, median delay (\d+) ms", said)
    assert told
    frames, forecasts, delay_ms = map(int, told.groups())
    assert frames == FRAMES
    assert 1 <= forecasts <= FRAMES - 3
    assert delay_ms > 0


def test_a_port_that_is_taken_gives_one_clear_line(address, tmp_path):
    clip = write_clip(tmp_path / "clip.mp4")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "rollcast", "live", str(clip), "--url", address]
        ended = subprocess.run(
            [*command, "--port", str(port)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert ended.returncode == 1
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert f"--port {port} is not free" in line
