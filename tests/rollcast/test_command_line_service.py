"""The commands that look at the service: simulate, models, doctor, serve; and the whole."""

import csv
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import httpx2
import numpy as np
import pytest
from inline_snapshot import snapshot
from PIL import Image

import rollcast
from rollcast.__main__ import main
from rollcast.client import Client
from rollcast.client.testing import FakeService
from rollcast.commands.serve import is_checkout
from rollcast.schemas import ModelEntry, ModelList, Problem
from tests.rollcast.clients import PROBLEM

COMMANDS = ["serve", "predict", "simulate", "models", "doctor"]


@pytest.fixture
def run(capsys):
    def run(*arguments, service=None):
        transport = service or FakeService()
        code = main(
            list(map(str, arguments)), lambda url: Client(url, transport=transport, retries=0)
        )
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_key_and_address_may_be_given_or_stand_in_the_environment(capsys, monkeypatch):
    seen = []

    def answer(request):
        seen.append((request.url.host, request.headers.get("authorization")))
        return httpx2.Response(200, json={"models": []})

    def connect(url=None, api_key=None):
        return Client(url, api_key=api_key, transport=httpx2.MockTransport(answer))

    assert main(["models"], connect) == 0
    monkeypatch.setenv("ROLLCAST_API_KEY", "standing")
    monkeypatch.setenv("ROLLCAST_URL", "http://robot:8000")
    assert main(["models"], connect) == 0
    assert main(["--api-key", "given", "models", "--url", "http://other"], connect) == 0
    assert seen == [
        ("127.0.0.1", None),
        ("robot", "Bearer standing"),
        ("other", "Bearer given"),
    ]


def test_a_scene_is_told(run):
    code, printed, errors = run("simulate", "ellipsoid", "--seed", 7, "--num-objects", 2)
    assert (code, errors) == (0, "")
    lines = printed.splitlines()
    assert lines[0] == "ellipsoid, seed 7: 44 steps, 40 a second"
    assert lines[3].split() == ["0.000", "0", "38.4", "38.4"]
    code, printed, _ = run("simulate", "ellipsoid", "--format", "csv", "--steps", 5)
    rows = list(csv.DictReader(io.StringIO(printed)))
    assert [row["step"] for row in rows] == ["0", "1", "2", "3", "4"]
    code, printed, _ = run("simulate", "heightfield", "--format", "json", "--steps", 5)
    answer = json.loads(printed)
    assert answer["scene"]["scenario"] == "heightfield"
    assert np.shape(answer["objects"][0]["positions"]) == (5, 2)


def test_a_scene_becomes_a_folder_that_predict_reads(run, tmp_path):
    out = tmp_path / "scene"
    code, printed, errors = run("simulate", "hemisphere", "--size", 64, "--out", out)
    assert (code, errors) == (0, "")
    assert printed.startswith(f"{out}: 44 frames, truth.csv and scene.json; ")
    assert f"`rollcast predict {out}`" in printed
    assert len(list(out.glob("frame*.png"))) == 44
    assert json.loads((out / "scene.json").read_text())["scenario"] == "hemisphere"
    truth = list(csv.DictReader(io.StringIO((out / "truth.csv").read_text())))
    code, printed, errors = run("predict", out, "--format", "csv", "--horizon", 20)
    assert (code, errors) == (0, "")
    forecast = list(csv.DictReader(io.StringIO(printed)))
    for row, true in zip(forecast, truth[3:], strict=False):
        assert float(row["x_px"]) == pytest.approx(float(true["x_px"]))


def test_the_frame_of_a_later_step_goes_along(run, tmp_path):
    assert run("simulate", "hemisphere", "--steps", 20, "--out", tmp_path / "scene")[0] == 0
    service = FakeService()
    code, printed, errors = run(
        "predict", tmp_path / "scene", "--final", 15, "--format", "csv", service=service
    )
    assert (code, errors) == (0, "")
    assert len(printed.splitlines()) == 1 + 16
    _, asked = service.requests  # the models first
    assert asked.fields["horizon"] == "16"
    assert asked.final_frame is not None
    shown = sorted((tmp_path / "scene").glob("*.png"))[18]
    with Image.open(io.BytesIO(asked.final_frame)) as sent, Image.open(shown) as picture:
        assert np.array_equal(np.asarray(sent), np.asarray(picture))
    code, printed, errors = run("predict", tmp_path / "scene", "--final", 17, service=service)
    assert (code, printed, errors.count("\n")) == (1, "", 1)
    assert "--final is 17, whose frame lies 0.50 s after the start of the footage" in errors
    assert [asked.path for asked in service.requests].count("/predict") == 1


def test_a_folder_may_have_its_truth_as_json(run, tmp_path):
    (tmp_path / "scene").mkdir()
    assert run("simulate", "hemisphere", "--out", tmp_path / "scene", "--format", "json")[0] == 0
    assert json.loads((tmp_path / "scene" / "truth.json").read_text())["frame_rate"] == 40


def test_nothing_is_written_over(run, tmp_path):
    (tmp_path / "notes.txt").touch()
    service = FakeService()
    code, _, errors = run("simulate", "hemisphere", "--out", tmp_path, service=service)
    assert (code, errors.count("\n")) == (1, 1)
    assert "is not an empty folder" in errors
    assert service.requests == []


def test_a_scene_becomes_a_video(run, tmp_path):
    out = tmp_path / "scene.gif"
    code, printed, errors = run("simulate", "hemisphere", "--steps", 6, "--out", out)
    assert (code, printed, errors) == (0, f"{out}: 6 frames\n", "")
    with Image.open(out) as video:
        assert (video.n_frames, video.size) == (6, (128, 128))
    code, _, errors = run("simulate", "hemisphere", "--size", 65, "--out", tmp_path / "scene.mp4")
    assert (code, errors) == (1, "rollcast: --size is 65; a video needs an even size\n")


class Listing(FakeService):
    """A service with models of one's own."""

    def __init__(self, *models):
        super().__init__()
        self.models = [ModelEntry.model_validate(model) for model in models]

    def _served(self, asked):
        if asked.path == "/models":
            content = ModelList(models=self.models).model_dump_json()
            return httpx2.Response(200, content=content)
        return super()._served(asked)


READY = {
    "name": "posnet",
    "version": 2,
    "default": True,
    "status": "ready",
    "variant": "posnet",
    "scenarios": ["hemisphere", "ellipsoid"],
    "objects": 1,
    "frames": 4,
    "trained_horizon": 20,
    "metrics": {"validation_error_px": 1.4142, "rows": []},
}
REFUSED = {"name": "broken", "version": 1, "status": "invalid", "reason": "a hash differs"}


def test_models_are_listed_and_refused_ones_say_why(run):
    service = Listing(READY, REFUSED)
    code, printed, errors = run("models", service=service)
    assert (code, errors) == (0, "")
    assert printed == snapshot("""\
MODEL      VARIANT  BALLS  FRAMES  HORIZON  ERROR_PX  SCENARIOS             STATUS
posnet@2*  posnet   1      4       20       1.41      hemisphere,ellipsoid  ready
broken@1                                                                    invalid: a hash differs
""")
    code, printed, _ = run("models", "--format", "json", service=service)
    assert [model["reason"] for model in json.loads(printed)] == [None, "a hash differs"]
    assert run("models", service=Listing())[1] == "the service has no models\n"


def test_a_doctor_who_finds_nothing(run):
    code, printed, errors = run("doctor")
    assert (code, errors) == (0, "")
    lines = printed.splitlines()
    assert all(line.startswith("ok   ") for line in lines)
    assert lines[0].startswith(f"ok   python: {sys.version_info.major}.")
    assert "httpx2 " in printed
    assert lines[-1] == (
        "ok   forecast: a simulated ball, 20 steps with fake@1: 0.0 px off on average, in 0 ms"
    )
    code, printed, _ = run("doctor", "--format", "json")
    assert {finding["verdict"] for finding in json.loads(printed)} == {"ok"}


class Draining(FakeService):
    def _answer(self, request):
        return httpx2.Response(503, json={"status": "draining"})


class Dead(httpx2.BaseTransport):
    def handle_request(self, request):
        raise httpx2.ConnectError("refused")


AILING = {
    "not ready": (Draining(), "FAIL service: http://127.0.0.1:8000 answers, but it is not ready"),
    "no models": (Listing(REFUSED), "FAIL models: 0 of 1 can be used"),
    "far off": (FakeService(np.zeros((20, 2))), "up to 10 px are expected"),
    "refuses": (FakeService(problem=Problem.model_validate(PROBLEM)), "FAIL service: A value"),
    "no service": (Dead(), "FAIL service: http://127.0.0.1:8000/health/ready does not answer"),
}


@pytest.mark.parametrize(("service", "told"), AILING.values(), ids=AILING)
def test_a_doctor_who_finds_something(run, service, told):
    code, printed, errors = run("doctor", service=service)
    assert (code, errors) == (1, "")
    assert told in printed
    assert any(line.startswith("FAIL ") for line in printed.splitlines())


def test_a_refused_model_is_a_note(run):
    code, printed, _ = run("doctor", service=Listing(READY, REFUSED))
    assert code == 0
    assert "note models: broken@1: a hash differs" in printed


def test_what_is_missing_is_a_note(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    code, printed, _ = run("doctor")
    assert code == 0
    assert "note video: pip install 'rollcast[video]', and videos can be read" in printed


def test_a_pyav_that_cannot_read_clips_fails(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "rollcast.video", None)
    code, printed, _ = run("doctor")
    assert code == 1
    assert "FAIL video: av " in printed
    assert "pip install -U 'rollcast[video]'" in printed


def test_outside_a_checkout_serve_prints_the_containers_command(tmp_path):
    package = Path(rollcast.__file__).parent
    shutil.copytree(package, tmp_path / "rollcast", ignore=shutil.ignore_patterns("__pycache__"))
    run = subprocess.run(
        [sys.executable, "-m", "rollcast", "serve", "--port", "9000"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert "-p 127.0.0.1:9000:8000" in run.stdout  # that it serves: tests/e2e/test_deployment.py
    assert "pip install 'rollcast[serve]'" in run.stderr  # that it works: tests/e2e/test_wheels.py
    assert run.stderr.count("\n") == 1
    assert not is_checkout(tmp_path)
    assert is_checkout(package.parent)


def test_an_interrupted_command_says_so(capsys):
    def connect(url):
        raise KeyboardInterrupt

    assert main(["models"], connect) == 130
    assert capsys.readouterr().err == "rollcast: interrupted\n"


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], []], ids=str)
def test_the_help_of_the_whole(run, monkeypatch, arguments):
    monkeypatch.setenv("COLUMNS", "100")
    code, printed, errors = run(*arguments)
    assert (code, errors) == (0, "")
    assert printed == snapshot("""\
Usage: rollcast [OPTIONS] COMMAND [ARGS]...

  Forecast where rolling balls go. All commands except serve call a running service (rollcast
  serve, or make serve).

  Example:
    rollcast serve &
    rollcast doctor
    rollcast simulate ellipsoid --seed 7 --out scene
    rollcast predict scene --out overlay.png

  Exit codes: 0 success, 1 failure (with one line on stderr), 2 invalid arguments. `rollcast
  --install-completion` completes commands and options in your shell.

Options:
  --version             print the version
  --api-key KEY         API key, for a service that requires one; prefer the environment variable
                        ROLLCAST_API_KEY
  --install-completion  Install completion for the current shell.
  --show-completion     Show completion for the current shell, to copy it or customize the
                        installation.
  -h, --help            Show this message and exit.

Commands:
  serve     Serve the models until stopped: those of this checkout, or of the package...
  predict   Forecast balls in a video or in images.
  live      Forecast balls in a running picture.
  simulate  Simulate a scene: its frames and the true path.
  track     Track balls in clips from an overhead camera.
  models    List the models of a service, with the reason for rejected ones.
  doctor    Check Python, packages and the service, up to a forecast of a simulated ball.
""")


def test_the_help_of_every_command(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    texts = {command: run(command, "--help")[1] for command in COMMANDS}
    assert texts["predict"] == snapshot("""\
Usage: rollcast predict [OPTIONS] {VIDEO|FOLDER|IMAGES}...

  Forecast balls in a video or in images.

  Reads four frames, requests a forecast from a running service, prints the path and, with --out,
  draws it over the footage. A model for any number of balls (any-ball) is sent whole pictures,
  and rings show where it saw the balls.

  Examples:
    rollcast predict clip.mp4 --start 2.0 --crop 100,0,480 --out overlay.png
    rollcast predict clip.mp4 --ball 412,230 --ball 105,88 --out rings.png
    rollcast predict clip.mp4 --stride 3 --out overlay.mp4 --slowdown 4
    rollcast predict frames/ --rate 120 --stride 3 --format csv > forecast.csv
    rollcast predict clip.mp4 --final 39 --out between.png

Arguments:
  VIDEO|FOLDER|IMAGES <list[Path]>
                                  a video, from which four frames are read, at 40 per second or at
                                  the model's rate (interpolated where the camera has none); or a
                                  folder of images, or at least four images  [required]

Options:
  --start SECONDS                 time of the first of the four frames in the video (default: 0)
  --stride N                      use every N-th frame without interpolation (default: 40 frames
                                  per second)
  --rate HZ                       frame rate of the camera in Hz, for images (default: 40),
                                  elementary streams, which do not state it, and slow motion,
                                  which is stored at a lower rate
  --crop X,Y,SIZE                 square crop given to the model: left column, top row, side, in
                                  pixels (default: the whole picture for a model for any number of
                                  balls, otherwise the largest square in the centre, which the
                                  bowl or plane should just fill)
  --final STEP                    give the model the frame of this step too, to interpolate the
                                  path: 39 with one ball, 29 with two or three
  --horizon STEPS                 number of steps to forecast, at the frame rate (default:
                                  {DEFAULT_HORIZON}; with --final up to that frame)
  --step-rate HZ                  steps of the forecast per second (default: the frame rate)
  --model NAME                    auto, NAME or NAME@VERSION  [default: auto]
  --num-objects BALLS             number of balls (default: the model's, 1 with auto; models for
                                  any number of balls forecast the moving ones)
  --ball X,Y[,RADIUS]             selects a ball by a point in the last of the four frames, in
                                  pixels of the uncropped picture; repeat for several balls, in
                                  the order of the answer
  --scenario <hemisphere|ellipsoid|heightfield|table|footage>
                                  restrict auto to models for this scenario
  --url ADDRESS                   address of the service (default: ROLLCAST_URL, else
                                  http://127.0.0.1:8000)
  --format <table|json|csv>       output format  [default: table]
  --out FILE                      draw the forecast over the footage: a picture (.png, .jpg,
                                  .webp) or a video (.mp4, .webm, .gif)
  --slowdown N                    play the video N times slower than real time  [default: 1]
  -h, --help                      Show this message and exit.
""")
    assert texts["simulate"] == snapshot("""\
Usage: rollcast simulate [OPTIONS] {SCENARIO}

  Simulate a scene: its frames and the true path.

  Without --out the path is printed. The same seed always produces the same frames.

  Examples:
    rollcast simulate ellipsoid --seed 7
    rollcast simulate ellipsoid --seed 7 --out scene && rollcast predict scene
    rollcast simulate heightfield --steps 200 --size 512 --out scene.mp4 --slowdown 2

Arguments:
  SCENARIO <hemisphere|ellipsoid|heightfield|table>
                                  kind of scene  [required]

Options:
  --seed SEED                seed of the scene  [default: 0]
  --num-objects BALLS        number of balls  [default: 1]
  --steps STEPS              number of frames, 40 per second  [default: 44]
  --size PIXELS              frame width and height  [default: 128]
  --url ADDRESS              address of the service (default: ROLLCAST_URL, else
                             http://127.0.0.1:8000)
  --format <table|json|csv>  output format  [default: table]
  --out FOLDER|FILE          an empty or new folder for the frames, the true path and the scene;
                             or a video of the frames (.mp4, .webm, .gif)
  --slowdown N               play the video N times slower than real time  [default: 1]
  -h, --help                 Show this message and exit.
""")
    assert texts["models"] == snapshot("""\
Usage: rollcast models [OPTIONS]

  List the models of a service, with the reason for rejected ones.

  NAME without a version selects the version marked with *. The error is measured on validation
  data, in pixels of 128 x 128 frames; HORIZON is the number of steps in the model's training.

  Examples:
    rollcast models
    rollcast models --format json

Options:
  --url ADDRESS          address of the service (default: ROLLCAST_URL, else
                         http://127.0.0.1:8000)
  --format <table|json>  output format  [default: table]
  -h, --help             Show this message and exit.
""")
    assert texts["doctor"] == snapshot("""\
Usage: rollcast doctor [OPTIONS]

  Check Python, packages and the service, up to a forecast of a simulated ball.

  Every line begins with ok, note (works with limitations) or FAIL. The exit code is 1 if anything
  fails.

  Examples:
    rollcast doctor
    rollcast doctor --url http://robot:8000 --format json

Options:
  --url ADDRESS          address of the service (default: ROLLCAST_URL, else
                         http://127.0.0.1:8000)
  --format <table|json>  output format  [default: table]
  -h, --help             Show this message and exit.
""")
    assert texts["serve"] == snapshot("""\
Usage: rollcast serve [OPTIONS]

  Serve the models until stopped: those of this checkout, or of the package rollcast-models.

  Outside a checkout, the extra serve installs what the service needs and the models. Without it,
  the command prints how to start the container, and the exit code is 1. `python -m service
  --help` describes every setting.

  Examples:
    rollcast serve
    rollcast serve --port 9000

Options:
  --host HOST  address to listen on; 0.0.0.0 opens the service to the network  [default:
               127.0.0.1]
  --port PORT  port, 0 for a free one  [default: 8000]
  -h, --help   Show this message and exit.
""")


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("rollcast pre", "predict"),
        ("rollcast simulate el", "ellipsoid"),
        ("rollcast predict --sl", "--slowdown"),
    ],
    ids=["a command", "a scenario", "an option"],
)
def test_a_shell_completes(words, completed):
    run = subprocess.run(
        [
            *("env", "_ROLLCAST_COMPLETE=complete_bash", f"COMP_WORDS={words}"),
            *(f"COMP_CWORD={len(words.split()) - 1}", sys.executable, "-m", "rollcast"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout.split() == [completed], run.stderr
