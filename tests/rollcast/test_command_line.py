"""The command line against a transport of its own; tests/e2e has it against the real service."""

import json
import socket
import sys
import tomllib
from pathlib import Path

import av
import httpx2
import numpy as np
import pytest
from PIL import Image

from rollcast.__main__ import main
from rollcast.client import Client

SIDE = 64


class Service(httpx2.BaseTransport):
    """Forecasts a ball that rolls one pixel a step from (10, 20); keeps what it was asked."""

    def __init__(self):
        self.requests = []
        self.known = {}

    def handle_request(self, request):
        if request.method == "GET":
            about = {"name": "dot", "version": 3, "status": "ready", "versions": [3]}
            told = {"licence": None, "card": None, "default": True, **about, **self.known}
            listed = request.url.path == "/models"
            return httpx2.Response(200, content=json.dumps({"models": [told]} if listed else told))
        body = request.read()
        self.requests.append(body)
        horizon, rate = int(field(body, "horizon")), float(field(body, "frame_rate"))
        ball = {
            "id": 0,
            "color": "red",
            "positions": [[10 + step, 20] for step in range(horizon)],
            "covariances": [[[4, 0], [0, 4]]] * horizon,
            "covariance_source": "predicted",
            "angular_velocities": None,
        }
        answer = {
            "model": {"name": "dot", "version": 3, "variant": "dotnet", "trained_horizon": 20},
            "frame_size": [SIDE, SIDE],
            "frame_rate": rate,
            "step_rate": rate,
            "objects": [ball],
            "times_s": [step / rate for step in range(horizon)],
            "ellipse50_radii": [1.2] * horizon,
            "final_positions": None,
            "warnings": ["beware"],
            "timing_ms": {"decode": 1, "encode": 2, "rollout": 3, "total": 6},
        }
        return httpx2.Response(200, content=json.dumps(answer))


def field(body, name):
    return body.split(f'name="{name}"\r\n\r\n'.encode())[1].split(b"\r\n")[0].decode()


@pytest.fixture
def service():
    return Service()


@pytest.fixture
def run(service, capsys):
    """Run a command and return its exit code, what it printed and its errors."""

    def run(*arguments, command="predict", transport=service):
        code = main([command, *map(str, arguments)], lambda url: Client(url, transport=transport))
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


@pytest.fixture
def video(tmp_path):
    """Two seconds of 30 frames each, 96 x 64."""
    path = tmp_path / "clip.mp4"
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, SIDE, "yuv420p"
        for number in range(60):
            frame = np.full((SIDE, 96, 3), 4 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def write_images(folder, count):
    folder.mkdir(exist_ok=True)
    paths = [folder / f"frame{number}.png" for number in range(count)]
    for number, path in enumerate(paths):
        Image.fromarray(np.full((SIDE, 80, 3), 10 * number, np.uint8)).save(path)
    return paths


def test_a_model_for_footage_gets_what_it_knows(run, service, video):
    setup = {"colors": ["#ff0000"], "crop": [20, 4, 60]}
    service.known = {"scenarios": ["footage"], "frame_rate_hz": 30.0, "setup": setup}
    code, printed, errors = run(video, "--model", "dot@3", "--horizon", 2)
    assert (code, errors) == (0, "")
    lines = printed.splitlines()
    assert lines[0] == "dot@3: four frames from 0.000 s to 0.100 s (30 a second), crop 20,4,60"
    assert lines[-1] == "warning: beware", "nothing is blended"
    _, printed, _ = run(video, "--model", "dot", "--horizon", 2, "--crop", "0,0,64", "--stride", 2)
    assert "(15 a second), crop 0,0,64" in printed.splitlines()[0]


def test_a_video(run, service, video, tmp_path):
    out = tmp_path / "overlay.png"
    code, printed, errors = run(
        video, "--start", 0.5, "--crop", "20,4,60", "--horizon", 41, "--model", "dot", "--out", out
    )
    assert (code, errors) == (0, "")
    lines = printed.splitlines()
    assert lines[0] == "dot@3: four frames from 0.500 s to 0.575 s (40 a second), crop 20,4,60"
    assert [line.split() for line in (lines[2], lines[3], lines[-3])] == [
        ["time_s", "ball", "x", "y"],
        ["0.000", "0", "30.0", "24.0"],
        ["1.000", "0", "70.0", "24.0"],
    ]
    assert lines[-2:] == [
        "warning: the camera took no frames 40 a second apart: they are blended from those before "
        "and after, up to 33 ms apart",
        "warning: beware",
    ]
    [body] = service.requests
    assert (field(body, "model"), field(body, "horizon")) == ("dot", "41")
    assert float(field(body, "frame_rate")) == pytest.approx(40, rel=1e-3)
    with Image.open(out) as picture:
        assert picture.size == (720 + 3 * 360, 720)


def test_a_video_that_ends_soon_has_fewer_later_frames(run, video, tmp_path):
    out = tmp_path / "overlay.webp"
    assert run(video, "--start", 1.8, "--out", out)[0] == 0
    with Image.open(out) as picture:
        assert picture.size == (720, 720)


def test_without_a_picture_it_prints_alone(run, video, tmp_path):
    before = sorted(tmp_path.iterdir())
    assert run(video)[0] == 0
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("as_folder", [True, False])
def test_images_or_their_folder(run, service, tmp_path, as_folder):
    paths = write_images(tmp_path / "images", 12)
    (tmp_path / "images" / "notes.txt").write_text("not a frame")
    out = tmp_path / "overlay.png"
    arguments = [tmp_path / "images"] if as_folder else paths
    code, printed, errors = run(*arguments, "--horizon", 9, "--out", out)
    assert (code, errors) == (0, "")
    assert "four frames from 0.000 s to 0.075 s (40 a second), crop 8,0,64" in printed
    assert float(field(service.requests[0], "frame_rate")) == pytest.approx(40)
    with Image.open(out) as picture:
        # Step 8 is frame 11, the last by number although not by name.
        panel = np.asarray(picture)[700, 720 + 3 * 360 - 20]
    assert panel.tolist() == [110, 110, 110]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.mp4"], "rollcast: nowhere.mp4 cannot be read: No such file or directory\n"),
        (["VIDEO", "--start", "2"], "{video} ends before 2.042 s; 4 frames from 2 s do not fit\n"),
        (["VIDEO", "--crop", "50,0,64"], "y 0..64, the picture is 96 x 64\n"),
        (["IMAGE", "IMAGE", "IMAGE"], "3 images, expected a video, a folder or at least four"),
        (["IMAGE", "IMAGE", "IMAGE", "IMAGE", "--start", "1"], "--start is for a video"),
        (["IMAGE", "IMAGE", "IMAGE", "VIDEO"], "{video} is not an image, expected one of"),
        (["FOLDER"], "0 images, expected"),
    ],
)
def test_input_that_cannot_be_used_is_one_line(run, service, video, tmp_path, arguments, message):
    [image] = write_images(tmp_path / "images", 1)
    (tmp_path / "empty").mkdir()
    names = {"VIDEO": video, "IMAGE": image, "FOLDER": tmp_path / "empty"}
    code, printed, errors = run(*[names.get(part, part) for part in arguments])
    assert (code, printed, errors.count("\n")) == (1, "", 1)
    assert errors.startswith("rollcast: ")
    assert message.format(video=video) in errors
    assert service.requests == []


DRAWN = "is not a .png, .jpg, .jpeg, .webp, .mp4, .webm, .gif file"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Missing argument"),
        (["clip.mp4", "--sideways"], "No such option: --sideways"),
        (["clip.mp4", "--crop", "1,2"], "1,2 is not X,Y,SIZE, three whole numbers"),
        (["clip.mp4", "--crop", "-1,2,3"], "'--crop'"),
        (["clip.mp4", "--start", "soon"], "soon is not a number of seconds"),
        (["clip.mp4", "--start", "nan"], "nan is not a number of seconds"),
        (["clip.mp4", "--stride", "0"], "0 is not a whole number from 1 to 1000"),
        (["clip.mp4", "--rate", "0"], "0 is not a rate in Hz"),
        (["clip.mp4", "--horizon", "0"], "0 is not a whole number from 1 to 1000"),
        (["clip.mp4", "--horizon", "1.5"], "1.5 is not a whole number from 1 to 1000"),
        (["clip.mp4", "--num-objects", "9"], "9 is not a whole number from 1 to 8"),
        (["clip.mp4", "--scenario", "box"], "box"),
        (["clip.mp4", "--format", "xml"], "xml"),
        (["clip.mp4", "--url", "127.0.0.1:8000"], "is not an address like http://127.0.0.1:8000"),
        (["clip.mp4", "--url", "http://"], "is not an address like"),
        (["clip.mp4", "--url", "http://here:there"], "is not an address like"),
        (["clip.mp4", "--out", "overlay.bmp"], f"overlay.bmp {DRAWN}"),
        (["clip.mp4", "--out", "nowhere/overlay.png"], "the folder nowhere does not exist"),
    ],
)
def test_wrong_arguments_are_told_in_a_line_before_anything_is_read(run, arguments, message):
    code, printed, errors = run(*arguments)
    assert (code, printed, errors.count("\n")) == (2, "", 1)
    assert errors.startswith("rollcast: ")
    assert message in errors
    assert errors.endswith("(rollcast predict --help has more)\n")


def test_a_service_that_does_not_run_is_one_line(video, capsys):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert main(["predict", str(video), "--url", f"http://127.0.0.1:{port}"]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"rollcast: http://127.0.0.1:{port}/models does not answer")
    assert printed.err.endswith("is the service running (make serve)?\n")
    assert printed.err.count("\n") == 1


def test_videos_without_pyav_say_what_to_install(run, video, monkeypatch):
    monkeypatch.setitem(sys.modules, "rollcast.video", None)
    code, _, errors = run(video)
    assert (code, errors) == (1, "rollcast: videos need PyAV: pip install 'rollcast[video]'\n")


def test_the_version_is_that_of_the_project(capsys):
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"rollcast {tomllib.loads(text)['project']['version']}\n"
