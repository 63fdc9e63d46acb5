"""The video guide's own commands and Python, on clips of every rate that cameras have."""

import io
import shlex
from contextlib import redirect_stderr, redirect_stdout
from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.__main__ import main
from rollcast.client import Client
from rollcast.client.testing import FakeService
from tests.docs.blocks import blocks

SECONDS = 3.5
RATES = {
    **{f"{rate} a second": (lambda index, rate=rate: index / rate)
       for rate in (24, 25, 29.97, 30, 50, 60, 120)},
    "varying": lambda index: index / 30 + 0.012 * (index % 3),
}  # fmt: skip
"""Time of a frame by its number."""
BLOCKS = [block for block in blocks() if block.page == "video.md"]
COMMANDS = [
    line.partition(" > ")[0]
    for block in BLOCKS
    if block.language == "sh"
    for line in block.text.splitlines()
    if line.startswith("rollcast predict clip.mp4") and "--rate" not in line
]
PYTHON = [block.text for block in BLOCKS if block.language == "python" and "clip.mp4" in block.text]


@pytest.fixture(params=RATES, scope="module")
def folder(request, tmp_path_factory):
    """A clip of 680 x 480: a ball goes round."""
    folder = tmp_path_factory.mktemp("clip")
    time_of, number = RATES[request.param], 0
    with av.open(folder / "clip.mp4", "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = 680, 480, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 10_000)
        while (time_s := time_of(number)) < SECONDS:
            picture = np.full((480, 680, 3), 90, np.uint8)
            x, y = 340 + 150 * np.cos(2 * time_s), 240 + 150 * np.sin(2 * time_s)
            picture[int(y) - 20 : int(y) + 20, int(x) - 20 : int(x) + 20] = 230
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = round(time_s * 10_000), Fraction(1, 10_000)
            container.mux(stream.encode(frame))
            number += 1
        container.mux(stream.encode())
    return folder


def run(command, folder, service):
    words = [str(folder / word) if "." in word and word.rpartition(".")[2] in
             {"mp4", "png", "gif"} else word for word in shlex.split(command)[1:]]  # fmt: skip
    said, errors = io.StringIO(), io.StringIO()
    with redirect_stdout(said), redirect_stderr(errors):
        code = main(words, lambda _: Client(transport=service))
    assert code == 0, errors.getvalue()
    assert "Traceback" not in errors.getvalue()
    return said.getvalue()


def test_there_is_something_to_try():
    assert len(COMMANDS) >= 4
    assert len(PYTHON) == 1


def test_commands_of_the_guide(folder):
    for command in COMMANDS:
        service = FakeService()
        run(command, folder, service)
        fields = service.requests[-1].fields
        assert float(fields["frame_rate"]) == pytest.approx(40, rel=0.06), command


def test_python_of_the_guide(folder, monkeypatch):
    monkeypatch.chdir(folder)
    text = PYTHON[0].replace('Client("http://127.0.0.1:8000")', "Client(transport=service)")
    with redirect_stdout(io.StringIO()) as said:
        exec(compile(text, "video.md", "exec"), {"service": FakeService()})
    assert said.getvalue()
    with Image.open(folder / "forecast.png") as picture:
        assert picture.height == 720


def test_seen_and_later_frames_show_one_ball_on_one_way(folder):
    """Both are resampled by the same rule, so no frame is off by more than blending."""
    service = FakeService()
    run("rollcast predict clip.mp4 --start 1.0 --crop 100,0,480 --final 39", folder, service)
    asked = service.requests[-1]
    places = []
    for data in (*asked.frames, asked.final_frame):
        with Image.open(io.BytesIO(data)) as image:
            bright = np.clip(np.asarray(image)[..., 1].astype(float) - 110, 0, None)
        rows, columns = np.mgrid[:480, :480] + 0.5
        places.append(
            ((bright * columns).sum() / bright.sum(), (bright * rows).sum() / bright.sum())
        )
    rate = float(asked.fields["frame_rate"])
    angles = [np.arctan2(y - 240, x - 240) for x, y in places]
    times_s = np.array([0, 1, 2, 3, 3 + 39]) / rate
    turned = np.unwrap(angles)
    np.testing.assert_allclose(turned - turned[0], 2 * times_s, atol=0.03)
