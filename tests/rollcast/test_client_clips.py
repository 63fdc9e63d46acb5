"""Videos as the frames of a forecast, with both clients."""

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.client.clips import told_rates
from rollcast.client.images import decoded, encoded
from rollcast.client.testing import FakeService
from rollcast.errors import FootageError, InvalidArgumentError
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


class ToldItsRate(FakeService):
    """A service with a model that is told the rate of its frames."""

    def _served(self, asked):
        response = super()._served(asked)
        if asked.path == "/models":
            (entry,) = response.json()["models"]
            told = {"models": [entry | {"frame_rates_hz": [15, 125]}]}
            response = type(response)(200, json=told)
        return response


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
    expected = read_frames(video, frame_rate=taken)
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
