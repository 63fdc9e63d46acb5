"""Videos as the frames of a forecast, with both clients."""

from dataclasses import replace
from typing import ClassVar

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.client.clips import told_rates
from rollcast.client.images import decoded, encoded
from rollcast.client.testing import FakeService
from rollcast.errors import FootageError, InvalidArgumentError
from rollcast.footage import WholePicture
from rollcast.frames import as_frame
from rollcast.schemas import ModelDetail
from rollcast.video import read_frames

SIDE = 48


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Two seconds at 40 frames a second, 64 x 48, each of another grey."""
    return written(tmp_path_factory.mktemp("clips") / "clip.mp4", rate=40)


def written(path, rate):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, SIDE, "yuv420p"
        for index in range(2 * rate):
            grey = np.full((SIDE, 64, 3), 40 + index, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("as_text", [False, True])
def test_four_frames_are_read_from_a_start_on(client, clip, as_text):
    service = FakeService()
    forecast = client(service).predict(str(clip) if as_text else clip, start_s=1.0, horizon=3)
    expected = read_frames(clip, start_s=1.0)
    asked = service.requests[-1]
    assert [*asked.frames] == [encoded(frame, None) for frame in expected.frames]
    assert float(asked.fields["frame_rate"]) == pytest.approx(40)
    assert "start_s" not in asked.fields
    assert forecast.frame_size == (SIDE, SIDE)
    (warning,) = forecast.warnings
    assert warning.startswith("the pictures are not square, and their middle was sent (8,0,48)")


def test_a_square_that_is_asked_for_is_cut_without_a_warning(client, clip):
    forecast = client(FakeService()).predict(clip, horizon=3, crop="square")
    assert forecast.frame_size == (SIDE, SIDE)
    assert forecast.warnings == ()


def test_streams_and_many_calls_take_videos_too(client, clip):
    service = FakeService()
    connected = client(service)
    stream = connected.predict_stream(clip, start_s=0.5, horizon=3)
    assert len(list(stream)) == 3
    forecasts = connected.predict_many([clip, clip], start_s=0.5, horizon=3)
    assert len(forecasts) == 2
    sent = [asked.frames for asked in service.requests if asked.path != "/models"]
    assert len({frames[0] for frames in sent}) == 1


def test_blended_frames_are_told(client, tmp_path):
    slow = written(tmp_path / "slow.mp4", rate=30)
    connected = client(FakeService())
    forecast = connected.predict(slow, horizon=3)
    assert "the camera took no frames 40 a second apart" in forecast.warnings[0]
    stream = connected.predict_stream(slow, horizon=3)
    assert len(list(stream)) == 3
    assert stream.forecast.warnings == forecast.warnings


class ServingEntry(FakeService):
    """A service whose model has further properties."""

    properties: ClassVar = {}

    def _served(self, asked):
        if asked.path.startswith("/predict") and "max_objects" in self.properties:
            # The fake reads rectangles where points select balls; this model finds them itself.
            found = {"balls": '[{"x": 9, "y": 9}]'}
            asked = replace(asked, fields={**asked.fields, **found})
        response = super()._served(asked)
        if asked.path == "/models":
            (entry,) = response.json()["models"]
            response = type(response)(200, json={"models": [entry | self.properties]})
        return response


class ToldItsRate(ServingEntry):
    """A service with a model that is told the rate of its frames."""

    properties: ClassVar = {"frame_rates_hz": [15, 125], "max_objects": 8}


class ForAnyNumber(ServingEntry):
    """A service with a model for any number of balls."""

    properties: ClassVar = {"max_objects": 8, "scenarios": ["ellipsoid"]}


@pytest.fixture
def portrait(tmp_path):
    """A clip of a phone that is held upright: the ball rolls above the square in the middle."""
    path = tmp_path / "phone.mp4"
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 72, 128, "yuv420p"
        for index in range(12):
            picture = np.full((128, 72, 3), 90, np.uint8)
            picture[6:18, 4 * index : 4 * index + 12] = 230
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("scenario", [None, "ellipsoid"])
def test_a_portrait_clip_is_sent_whole_where_auto_reads_it(client, portrait, scenario):
    service = ForAnyNumber()
    forecast = client(service).predict(portrait, horizon=3, scenario=scenario, frame_rate=30)
    assert forecast.frame_size == (72, 128)
    assert forecast.warnings == ()
    assert as_frame(service.requests[-1].frames[0])[:24].max() > 200, "the ball is there"


NOT_WHOLE = {
    "a final frame": ({}, {"final_frame": np.zeros((72, 72, 3), np.uint8)}),
    "another scenario": ({}, {"scenario": "hemisphere"}),
    "no default version": ({"default": False}, {}),
    "not loaded": ({"status": "unloaded"}, {}),
}


@pytest.mark.parametrize("case", NOT_WHOLE)
def test_a_portrait_clip_that_auto_crops_is_reported(client, portrait, case):
    properties, options = NOT_WHOLE[case]
    service = ForAnyNumber()
    service.properties = service.properties | properties
    forecast = client(service).predict(portrait, horizon=3, frame_rate=30, **options)
    assert forecast.frame_size == (72, 72)
    assert "their middle was sent (0,28,72)" in forecast.warnings[-1]


@pytest.mark.parametrize(
    ("rate", "taken"), [(30, 30), (24, 24), (50, 50), (60, 30), (80, 40), (100, 50)]
)
def test_frames_are_as_they_were_taken_for_a_model_that_is_told_their_rate(
    client, tmp_path, rate, taken
):
    video = written(tmp_path / "clip.mp4", rate=rate)
    service = ToldItsRate()
    forecast = client(service).predict(video, horizon=3)
    assert forecast.warnings == ()
    assert float(service.requests[-1].fields["frame_rate"]) == pytest.approx(taken, rel=0.02)
    expected = read_frames(video, frame_rate=taken, crop=WholePicture())
    assert [*service.requests[-1].frames] == [encoded(frame, None) for frame in expected.frames]


def test_a_rate_that_is_asked_for_is_blended(client, tmp_path):
    video = written(tmp_path / "clip.mp4", rate=30)
    forecast = client(ToldItsRate()).predict(video, horizon=3, frame_rate=40)
    assert "no frames 40 a second apart" in forecast.warnings[0]


def test_a_clip_with_a_final_frame_is_read_for_models_that_are_not_told_the_rate(client, tmp_path):
    video = written(tmp_path / "clip.mp4", rate=30)
    service = ToldItsRate()
    final = np.full((SIDE, SIDE, 3), 90, np.uint8)
    forecast = client(service).predict(video, final_frame=final, horizon=3)
    assert "no frames 40 a second apart" in forecast.warnings[0]
    assert float(service.requests[-1].fields["frame_rate"]) == pytest.approx(40)


def test_a_named_version_is_told_its_rate_and_auto_asks_default_ones(client):
    (entry,) = client(FakeService()).models()
    told = entry.model_copy(update={"frame_rates_hz": (15.0, 125.0), "default": False})
    assert told_rates([told]) == (15, 125)
    assert told_rates([told, entry]) is None
    unloaded = told.model_copy(update={"default": True, "status": "unloaded"})
    assert told_rates([unloaded, entry]) is None


def test_a_model_says_how_its_videos_are_read(client, clip):
    class OfASetUp(FakeService):
        def _served(self, asked):
            response = super()._served(asked)
            if asked.path == "/models/fake":
                entry = ModelDetail.model_validate_json(response.content)
                setup = {"colors": ["red"], "crop": (8, 4, 40)}
                changed = entry.model_copy(update={"frame_rate_hz": 20.0}).model_dump()
                response = type(response)(200, json=changed | {"setup": setup})
            return response

    service = OfASetUp()
    forecast = client(service).predict(clip, horizon=3, model="fake")
    assert [asked.path for asked in service.requests] == ["/models/fake", "/predict"]
    assert forecast.frame_size == (40, 40)
    assert forecast.frame_rate == pytest.approx(20)


def test_what_cannot_be_read(client, clip):
    connected = client(FakeService())
    with pytest.raises(FootageError, match="ends before"):
        connected.predict(clip, start_s=5.0)
    with pytest.raises(FootageError, match="no-such"):
        connected.predict("no-such.mp4")
    with pytest.raises(InvalidArgumentError, match="start_s is for a clip"):
        connected.predict(np.zeros((4, 48, 48, 3), np.uint8), start_s=1.0)


class Named:
    """A path of another library."""

    def __init__(self, path):
        self._path = path

    def __fspath__(self):
        return str(self._path)


def test_a_path_of_another_library_is_a_clip(client, clip):
    service = FakeService()
    client(service).predict(Named(clip), horizon=3)
    client(service).predict(clip, horizon=3)
    first, second = (asked for asked in service.requests if asked.path == "/predict")
    assert first.frames == second.frames


def test_a_clip_has_its_own_order_of_channels(client, clip):
    service = FakeService()
    connected = client(service)
    final = np.zeros((SIDE, SIDE, 3), np.uint8)
    final[..., 0] = 200  # blue, in the order of OpenCV
    connected.predict(clip, horizon=3, final_frame=final, channels="bgr")
    connected.predict(clip, horizon=3, final_frame=final[..., ::-1])
    one, other = (asked for asked in service.requests if asked.path == "/predict")
    assert one.frames == other.frames
    assert one.final_frame == other.final_frame


def test_the_cameras_rate_can_be_stated(client, clip):
    service = FakeService()
    client(service).predict(clip, camera_hz=120, horizon=3)
    expected = read_frames(clip, camera_hz=120)
    assert [*service.requests[-1].frames] == [encoded(frame, None) for frame in expected.frames]
    assert "camera_hz" not in service.requests[-1].fields


@pytest.mark.parametrize("kind", ["folder", "stack.tif"])
def test_folders_and_stacks_are_clips(client, tmp_path, kind):
    pictures = [Image.fromarray(np.full((SIDE, SIDE, 3), 40 + n, np.uint8)) for n in range(6)]
    path = tmp_path / kind
    if kind == "folder":
        path.mkdir()
        for number, picture in enumerate(pictures):
            picture.save(path / f"f{number}.png")
    else:
        pictures[0].save(path, save_all=True, append_images=pictures[1:])
    service = FakeService()
    client(service).predict(path, camera_hz=40, start_s=0.025, horizon=3)
    assert [decoded(frame)[0, 0, 0] for frame in service.requests[-1].frames] == [41, 42, 43, 44]


def test_an_empty_folder_is_told(client, tmp_path):
    with pytest.raises(FootageError, match="has no frames"):
        client(FakeService()).predict(tmp_path)


WRONG = [
    {"model": 3},
    {"model": None},
    {"frame_rate": -1},
    {"frame_rate": 0},
    {"frame_rate": float("nan")},
    {"frame_rate": float("inf")},
    {"frame_rate": 10**400},
    {"frame_rate": "40"},
    {"frame_rate": []},
    {"camera_hz": 0},
    {"camera_hz": "40"},
    {"step_rate": "40"},
    {"start_s": "1"},
    {"start_s": []},
    {"horizon": "3"},
    {"num_objects": 1.5},
    {"balls": 3},
]


@pytest.mark.parametrize("options", WRONG, ids=str)
def test_a_wrong_option_of_a_clip_is_the_documented_error(client, clip, options):
    with pytest.raises(InvalidArgumentError, match=next(iter(options))):
        client(FakeService()).predict(clip, **options)


@pytest.mark.parametrize("start_s", [-1, float("nan"), float("inf"), 1e300])
def test_a_start_outside_the_clip_is_told(client, clip, start_s):
    with pytest.raises(FootageError):
        client(FakeService()).predict(clip, start_s=start_s)


@pytest.mark.parametrize("path", ["a\0b.mp4", "", "missing.mp4", "x" * 5000, "a\udcffb.mp4"])
def test_a_wrong_path_is_the_documented_error(client, path):
    with pytest.raises(FootageError):
        client(FakeService()).predict(path)
