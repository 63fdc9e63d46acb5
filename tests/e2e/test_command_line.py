"""The command line as its users call it: a process, a video file and the real service."""

import csv
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress

import av
import numpy as np
import pytest
from PIL import Image, ImageColor

from rollcast.plot import OVERVIEW_PX, PALETTE, PANEL_PX
from tests.e2e.conftest import ROOT, said_address

SIDE = 128
BESIDE = 32  # columns of the video to the left and right of the scene


def predict(*arguments):
    return rollcast("predict", *arguments)


def rollcast(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "rollcast", *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def scene(client):
    return client.simulate("hemisphere", seed=7, image_size=SIDE)


@pytest.fixture
def video(scene, tmp_path):
    """The scene at 40 frames a second after ten frames of nothing, with a margin at both sides."""
    path = tmp_path / "scene.mkv"
    nothing = np.zeros((10, *scene.frames.shape[1:]), np.uint8)
    frames = np.concatenate([nothing, scene.frames])
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", rate=40)
        stream.width, stream.height, stream.pix_fmt = SIDE + 2 * BESIDE, SIDE, "bgr0"
        for frame in np.pad(frames, ((0, 0), (0, 0), (BESIDE, BESIDE), (0, 0))):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_a_video_becomes_the_forecast_of_its_frames(address, client, scene, video, tmp_path):
    out = tmp_path / "overlay.png"
    run = predict(
        *(video, "--start", 0.25, "--crop", f"{BESIDE},0,{SIDE}", "--horizon", 41),
        *("--model", "posnet", "--url", address, "--out", out),
    )
    assert (run.returncode, run.stderr) == (0, "")
    expected = client.predict(scene.frames[:4], horizon=41, model="posnet")
    lines = run.stdout.splitlines()
    model = f"{expected.model.name}@{expected.model.version}"
    assert lines[0] == (
        f"{model}: four frames from 0.250 s to 0.325 s (40 a second), crop {BESIDE},0,{SIDE}"
    )
    rows = np.array([line.split() for line in lines if re.match(" +[0-9]", line)], float)
    np.testing.assert_allclose(rows[-1, 0], 1.0, atol=1e-3)
    for time_s, _, x, y in rows:
        position = expected.positions[0, round(time_s * 40)] + [BESIDE, 0]
        np.testing.assert_allclose([x, y], position, atol=0.1)
    assert [line for line in lines if line.startswith("warning: ")] == [
        f"warning: {warning}" for warning in expected.warnings
    ]
    with Image.open(out) as picture:
        assert picture.size == (OVERVIEW_PX + 3 * PANEL_PX, OVERVIEW_PX)
        pixels = np.asarray(picture, int)
    scale = OVERVIEW_PX / SIDE
    seen = 0
    for x, y in expected.positions[0, 5:15]:
        column, row = (np.array([x, y]) * scale).astype(int)
        drawn = pixels[row - 1 : row + 2, column - 1 : column + 2]
        seen += np.abs(drawn - ImageColor.getrgb(PALETTE[0])).max(axis=-1).min() < 40
    # A mark, an ellipse or a label may lie over the path.
    assert seen >= 8


def test_what_the_service_refuses_is_one_line(address, video):
    run = predict(video, "--crop", "0,0,128", "--model", "nonet", "--url", address)
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.startswith("rollcast: ")
    assert "(404)" in run.stderr
    assert run.stderr.count("\n") == 1


def test_a_service_that_does_not_run_is_one_line(video):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    run = predict(video, "--url", f"http://127.0.0.1:{port}")
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.endswith("is the service running (make serve)?\n")
    assert run.stderr.count("\n") == 1


def test_a_reader_that_has_seen_enough_is_no_error(address, video):
    command = [sys.executable, "-m", "rollcast", "predict", str(video), "--url", address]
    command += ["--start", "0.25", "--crop", f"{BESIDE},0,{SIDE}"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        assert run.stderr is not None
        run.stdout.close()
        assert run.stderr.read() == ""
    assert run.returncode == 0


def test_a_video_of_a_video_and_its_forecast(address, video, tmp_path):
    out = tmp_path / "overlay.mp4"
    crop = ("--crop", f"{BESIDE},0,{SIDE}")
    run = predict(video, "--start", 0.25, *crop, "--url", address, "--out", out, "--format", "csv")
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("\n") == 1 + 40
    with av.open(out) as container:
        assert len(list(container.decode(video=0))) == 3 + 40


def test_a_terminal_sees_progress_and_a_pipe_does_not(address, video, tmp_path):
    command = [sys.executable, "-m", "rollcast", "predict", str(video), "--url", address]
    terminal, stderr = pty.openpty()
    with subprocess.Popen(
        [*command, "--crop", f"{BESIDE},0,{SIDE}", "--out", str(tmp_path / "overlay.gif")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    ) as run:
        os.close(stderr)
        seen = b""
        with suppress(OSError):  # the terminal's other end is closed
            while part := os.read(terminal, 4096):
                seen += part
        os.close(terminal)
        assert run.stdout is not None
        printed = run.stdout.read()
    assert run.returncode == 0
    assert b"waiting for the forecast" in seen
    assert b"drawing" in seen
    assert "\x1b" not in printed


def test_a_scene_in_a_folder_is_forecast_where_its_balls_go(address, tmp_path):
    scene = tmp_path / "scene"
    run = rollcast("simulate", "ellipsoid", "--seed", 7, "--url", address, "--out", scene)
    assert (run.returncode, run.stderr) == (0, "")
    run = predict(scene, "--url", address, "--horizon", 20, "--format", "json")
    assert (run.returncode, run.stderr) == (0, "")
    forecast = np.array(json.loads(run.stdout)["objects"][0]["positions"])
    with (scene / "truth.csv").open() as file:
        truth = np.array([[row["x_px"], row["y_px"]] for row in csv.DictReader(file)], float)
    assert np.linalg.norm(forecast - truth[3:23], axis=1).mean() < 5


def test_with_its_last_frame_a_scene_is_forecast_in_between(address, tmp_path):
    scene = tmp_path / "scene"
    run = rollcast("simulate", "hemisphere", "--seed", 3, "--url", address, "--out", scene)
    assert (run.returncode, run.stderr) == (0, "")
    run = predict(scene, "--url", address, "--final", 39, "--format", "json")
    assert (run.returncode, run.stderr) == (0, "")
    answer = json.loads(run.stdout)
    assert len(answer["times_s"]) == 40
    forecast = np.array(answer["objects"][0]["positions"])
    with (scene / "truth.csv").open() as file:
        truth = np.array([[row["x_px"], row["y_px"]] for row in csv.DictReader(file)], float)
    assert np.linalg.norm(forecast - truth[3:43], axis=1).mean() < 3
    run = predict(scene, "--url", address, "--final", 20)
    assert (run.returncode, run.stderr.count("\n")) == (1, 1)
    assert "39" in run.stderr


def test_models_and_the_doctor(address):
    run = rollcast("models", "--url", address)
    assert (run.returncode, run.stderr) == (0, "")
    assert re.search(r"^posnet@1\* .* ready$", run.stdout, re.MULTILINE)
    run = rollcast("doctor", "--url", address)
    assert (run.returncode, run.stderr) == (0, ""), run.stdout
    assert "FAIL" not in run.stdout


def test_serve_becomes_the_service():
    with subprocess.Popen(
        [sys.executable, "-m", "rollcast", "serve", "--port", "0"],
        cwd=ROOT / "tests",  # from wherever it is called
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as service:
        assert service.stdout is not None
        address = said_address(service.stdout)
        run = rollcast("models", "--url", address)
        service.terminate()
    assert service.returncode in {0, -signal.SIGTERM}
    assert run.returncode == 0 or "not ready" in run.stderr
