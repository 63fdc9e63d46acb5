"""``rollcast predict``: what it reads, prints and draws beyond a table and a picture."""

import csv
import io
import json

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.__main__ import main
from rollcast.client import Client
from rollcast.client.testing import FakeService
from rollcast.plot import VIDEO_PX
from tests.rollcast.test_client_clips import ForAnyNumber

SIDE = 64
OFF = 8
"""Columns beside the square that is looked at."""


@pytest.fixture
def service():
    return FakeService()


@pytest.fixture
def run(service, capsys):
    def run(*arguments):
        code = main(["predict", *map(str, arguments)], lambda url: Client(url, transport=service))
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


@pytest.fixture
def images(tmp_path):
    """Twelve images, each a little brighter."""
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(12):
        picture = np.full((SIDE, SIDE + 2 * OFF, 3), 20 * number, np.uint8)
        Image.fromarray(picture).save(folder / f"frame{number}.png")
    return folder


@pytest.fixture
def video(tmp_path):
    """A second of 60 frames, each a little brighter."""
    path = tmp_path / "clip.mkv"
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", rate=60)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "bgr0"
        for number in range(60):
            frame = np.full((SIDE, SIDE, 3), 4 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def frame_rate(service):
    return float(service.requests[-1].fields["frame_rate"])


def brightness(service):
    """Of the frames that were sent."""
    return [
        int(np.asarray(Image.open(io.BytesIO(frame)))[0, 0, 0])
        for frame in service.requests[-1].frames
    ]


def test_every_nth_frame_of_a_video(run, service, video):
    assert run(video, "--stride", 3, "--start", 0.1)[0] == 0
    assert frame_rate(service) == pytest.approx(20, rel=0.02)
    np.testing.assert_allclose(brightness(service), [24, 36, 48, 60], atol=1)
    assert run(video, "--stride", 1)[0] == 0
    assert frame_rate(service) == pytest.approx(60, rel=0.02)
    np.testing.assert_allclose(brightness(service), [0, 4, 8, 12], atol=1)


def test_every_nth_image_and_their_rate(run, service, images):
    assert run(images, "--stride", 2, "--rate", 100)[0] == 0
    assert frame_rate(service) == pytest.approx(50)
    assert brightness(service) == [0, 40, 80, 120]
    assert "ends before 0.300 s; 4 frames from 0 s do not fit" in run(images, "--stride", 4)[2]


def test_slow_motion_has_the_rate_that_is_named(run, service, video):
    assert run(video, "--rate", 240, "--stride", 6, "--start", 0.05)[0] == 0
    assert frame_rate(service) == pytest.approx(40)
    # Frame 12 of 60 a second was taken after 0.05 s, not after 0.2 s.
    np.testing.assert_allclose(brightness(service), [48, 72, 96, 120], atol=1)


def test_what_is_asked_of_the_service(run, service, images):
    options = ["--num-objects", 2, "--scenario", "ellipsoid", "--model", "fake", "--horizon", 7]
    assert run(images, *options)[0] == 0
    fields = service.requests[-1].fields
    assert {name: fields[name] for name in ("num_objects", "scenario", "model", "horizon")} == {
        "num_objects": "2",
        "scenario": "ellipsoid",
        "model": "fake",
        "horizon": "7",
    }


def test_csv_has_every_step_of_every_ball(run, images):
    code, printed, errors = run(
        images, "--format", "csv", "--num-objects", 2, "--horizon", 30, "--crop", f"{OFF},0,{SIDE}"
    )
    assert code == 0
    assert errors.startswith("rollcast: warning: The horizon of 30 steps"), "CSV has no place"
    rows = list(csv.DictReader(io.StringIO(printed)))
    assert len(rows) == 60
    with Client(transport=FakeService()) as client:
        forecast = client.predict(np.zeros((4, SIDE, SIDE, 3), np.uint8), num_objects=2, horizon=30)
    path = [[float(row["x_px"]), float(row["y_px"])] for row in rows if row["color"] == "green"]
    np.testing.assert_allclose(path, forecast.positions[1] + [OFF, 0])


def test_json_is_the_whole_forecast(run, images):
    code, printed, errors = run(images, "--format", "json", "--horizon", 25)
    assert (code, errors) == (0, "")
    answer = json.loads(printed)
    assert (answer["model"], answer["frame_rate"]) == ("fake@1", 40)
    assert answer["crop"] == {"x": OFF, "y": 0, "size": SIDE}
    assert np.shape(answer["objects"][0]["positions"]) == (25, 2)
    assert np.shape(answer["objects"][0]["covariances"]) == (25, 2, 2)
    assert answer["objects"][0]["positions"][0][0] > OFF + 0.3 * SIDE
    cropped, horizon = answer["warnings"]
    assert "are not square, and their middle was sent" in cropped
    assert "horizon of 25" in horizon


def video_frames(path):
    """Every picture of a video and how long it lasts, seconds."""
    if path.suffix == ".gif":
        with Image.open(path) as video:
            frames = []
            for number in range(video.n_frames):
                video.seek(number)
                frames.append((np.asarray(video.convert("RGB")), video.info["duration"] / 1000))
        return frames
    with av.open(path) as container:
        rate = float(container.streams.video[0].average_rate)
        return [(frame.to_ndarray(format="rgb24"), 1 / rate) for frame in container.decode(video=0)]


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".gif"])
def test_a_video_shows_the_footage_with_the_forecast_over_it(run, images, tmp_path, suffix):
    out = tmp_path / f"overlay{suffix}"
    code, printed, errors = run(images, "--out", out, "--horizon", 15, "--slowdown", 2)
    assert (code, errors) == (0, ""), printed
    frames = video_frames(out)
    assert len(frames) == 3 + 15
    assert all(frame.shape == (VIDEO_PX, VIDEO_PX, 3) for frame, _ in frames)
    assert sum(seconds for _, seconds in frames) == pytest.approx(18 / 20, rel=0.05)
    corner = [int(frame[-5, -5, 0]) for frame, _ in frames]
    # The footage goes on under the forecast, and its last frame stays when it ends.
    np.testing.assert_allclose(corner, [20 * min(index, 11) for index in range(18)], atol=8)
    scale = VIDEO_PX / SIDE
    for index, (frame, _) in enumerate(frames):
        x, y = (np.array([0.3 + 0.01 * index, 0.3 + 0.004 * index]) * SIDE * scale).astype(int)
        patch = frame[y - 3 : y + 4, x - 3 : x + 4].astype(int)
        contrast = int(np.abs(patch - corner[index]).max())
        assert (contrast > 60) == (index >= 3), "the observed frames are shown as they are"


def test_a_video_over_a_video(run, video, tmp_path):
    out = tmp_path / "overlay.mp4"
    assert run(video, "--out", out, "--horizon", 100, "--start", 0.2)[0] == 0
    frames = video_frames(out)
    assert len(frames) == 103
    corner = [int(frame[-5, -5, 0]) for frame, _ in frames]
    assert corner[20] > corner[5] + 20
    np.testing.assert_allclose(corner[60:], corner[-1], atol=4)


def test_points_say_which_balls_are_meant(run, service, images):
    """They are pixels of the uncropped picture, as all that is printed."""
    code, out, _ = run(images, "--ball", "70,20", "--ball", "10,40,5", "--format", "json")
    told = json.loads(out)
    assert code == 0
    assert told["crop"] is None
    width, height = SIDE + 2 * OFF, SIDE
    assert Image.open(io.BytesIO(service.requests[-1].frames[0])).size == (width, height)
    first, second = told["objects"]
    assert first["positions"][0] == pytest.approx([70, 20])
    assert second["seen"][3] == pytest.approx({"x": 10, "y": 40, "radius": 5})
    assert second["score"] > 0.5


def test_points_stay_those_of_the_picture_with_a_crop(run, service, images):
    code, out, _ = run(images, "--ball", "30,20", "--crop", f"{OFF},0,{SIDE}", "--format", "json")
    assert code == 0
    assert json.loads(service.requests[-1].fields["balls"])[0]["x"] == 30 - OFF
    told = json.loads(out)["objects"][0]
    assert told["positions"][0] == pytest.approx([30, 20])
    assert told["seen"][3]["x"] == pytest.approx(30)


def test_a_table_says_where_each_ball_was_seen(run, images):
    _, out, _ = run(images, "--ball", "30,20,5")
    assert "whole pictures" in out
    assert "ball 0: seen at 30.0, 20.0, radius 5.0 px, score 0.99" in out


@pytest.mark.parametrize("kind", ["png", "mp4"])
def test_whole_pictures_are_drawn_whole(run, images, tmp_path, kind):
    path = tmp_path / f"drawn.{kind}"
    assert run(images, "--ball", "30,20", "--out", path)[0] == 0
    if kind == "png":
        with Image.open(path) as picture:
            width, height = picture.size
    else:
        with av.open(path) as video:
            width, height = video.streams.video[0].width, video.streams.video[0].height
    assert width > height


@pytest.mark.parametrize("given", ["30", "30,20,5,1", "-3,4", "a,b", "1,2,0", "nan,2"])
def test_what_is_no_point_is_refused(run, images, given):
    code, _, err = run(images, f"--ball={given}")
    assert code == 2
    assert given in err


@pytest.mark.parametrize("ending", [".png", ".gif"])
def test_a_terminal_names_the_stage_of_how_many(run, video, tmp_path, monkeypatch, ending):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes any stream for a terminal
    out = tmp_path / f"overlay{ending}"
    code, _, shown = run(video, "--horizon", "3", "--out", out)
    assert code == 0
    for stage in ("1 of 3: reading the footage", "2 of 3: waiting", "3 of 3: drawing"):
        assert stage in shown
    monkeypatch.delenv("FORCE_COLOR")
    assert " of " not in run(video, "--horizon", "3")[2]


@pytest.fixture
def portrait(tmp_path):
    """A second of a phone that is held upright."""
    path = tmp_path / "phone.mkv"
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = SIDE, 2 * SIDE, "bgr0"
        for number in range(30):
            frame = np.full((2 * SIDE, SIDE, 3), 8 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("more", [[], ["--crop", f"0,0,{SIDE}"], ["--final", "5"]])
def test_a_portrait_clip_is_cropped_with_a_warning_only_by_default(run, service, portrait, more):
    code, _, errors = run(portrait, "--horizon", "6", "--rate", "30", "--format", "csv", *more)
    assert code == 0, errors
    assert ("are not square, and their middle was sent" in errors) == ("--crop" not in more)
    for data in service.requests[-1].frames:
        with Image.open(io.BytesIO(data)) as picture:
            assert picture.size == (SIDE, SIDE)


def test_a_portrait_clip_is_sent_whole_where_auto_reads_it(portrait, capsys):
    service = ForAnyNumber()
    command = ["predict", str(portrait), "--horizon", "6", "--format", "csv"]
    assert main(command, lambda url: Client(url, transport=service)) == 0
    assert "square" not in capsys.readouterr().err
    for data in service.requests[-1].frames:
        with Image.open(io.BytesIO(data)) as picture:
            assert picture.size == (SIDE, 2 * SIDE)
