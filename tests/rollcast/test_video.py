"""Reading frames of videos that are made here: each frame tells its number by its brightness."""

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.clip import open_clip
from rollcast.errors import CropError, FootageEndedError, FootageError
from rollcast.footage import SquareCrop
from rollcast.video import camera_rate, frames_at, read_frames

WIDTH, HEIGHT = 96, 64
STEP = 4  # of brightness between two frames


def picture(number):
    """A frame; its left half is darker and its upper left corner is red."""
    frame = np.full((HEIGHT, WIDTH, 3), 20 + STEP * number, np.uint8)
    frame[:, : WIDTH // 2] -= 16
    frame[:16, :16] = [200, 0, 0]
    return frame


def write_video(path, times_ms, codec="libx264", pixel_aspect=None, **options):
    """Write one frame for each time; H.264 stores them in another order."""
    with av.open(path, "w") as container:
        stream = container.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        if pixel_aspect:
            stream.codec_context.sample_aspect_ratio = pixel_aspect
        for number, time_ms in enumerate(times_ms):
            frame = av.VideoFrame.from_ndarray(picture(number), format="rgb24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def even(rate, frames=50, first_ms=0):
    return [first_ms + round(1000 * index / rate) for index in range(frames)]


def places(footage):
    """Where in the video these are, counted in frames: between two where they were blended."""
    return (footage.frames[:, -8:, -8:].mean(axis=(1, 2, 3)) - 20) / STEP


def numbers(footage):
    """Which frames of the video these are."""
    return np.round(places(footage)).astype(int).tolist()


@pytest.mark.parametrize(
    ("rate", "every", "real_rate"),
    [(40, 1, 40), (39, 1, 39.5), (80, 2, 40), (119.88, 3, 39.96), (240, 6, 40)],
)
def test_every_mth_frame_of_a_camera_whose_rate_is_a_multiple(tmp_path, rate, every, real_rate):
    video = write_video(tmp_path / "clip.mp4", even(rate, frames=58))
    footage = read_frames(video, start_s=0.1)
    first = round(0.1 * rate)
    assert numbers(footage) == [first, first + every, first + 2 * every, first + 3 * every]
    assert footage.frames.shape == (4, HEIGHT, HEIGHT, 3)
    assert footage.frames.dtype == np.uint8
    assert footage.blended_over_s == 0
    assert footage.frame_rate == pytest.approx(real_rate, rel=0.01)
    assert camera_rate(video) == pytest.approx(rate, rel=0.02), "containers round times"


@pytest.mark.parametrize("rate", [15, 24, 25, 29.97, 48, 50, 60, 100])
def test_frames_that_no_camera_took_are_blended(tmp_path, rate):
    video = write_video(tmp_path / "clip.mp4", even(rate, frames=58))
    footage = read_frames(video, start_s=0.4)
    assert footage.times_s[0] == pytest.approx(round(0.4 * rate) / rate, abs=1e-3)
    # Frame k comes k / 40 s later, but for those that are near enough to one that was taken.
    np.testing.assert_allclose(footage.times_s - footage.times_s[0], np.arange(4) / 40, atol=4e-3)
    np.testing.assert_allclose(places(footage), footage.times_s * rate, atol=0.4)
    assert footage.blended_over_s == pytest.approx(1 / rate, abs=1e-3)


@pytest.mark.parametrize(
    ("rate", "every"),
    [(14.5, 1), (15, 1), (24, 1), (29.97, 1), (50, 1), (60, 2), (100, 2), (240, 6)],
)
def test_a_model_that_is_told_the_rate_gets_the_frames_that_were_taken(tmp_path, rate, every):
    video = write_video(tmp_path / "clip.mp4", even(rate, frames=58))
    footage = read_frames(video, told_rates=(15, 125))
    assert numbers(footage) == [0, every, 2 * every, 3 * every]
    assert footage.blended_over_s == 0
    assert footage.frame_rate == pytest.approx(rate / every, rel=0.02)


def test_rates_that_a_model_is_not_told_are_blended(tmp_path):
    video = write_video(tmp_path / "clip.mp4", even(10, frames=30))
    assert read_frames(video, told_rates=(15, 125)).blended_over_s > 0


def test_another_rate_may_be_asked_for(tmp_path):
    video = write_video(tmp_path / "clip.mp4", even(30))
    assert numbers(read_frames(video, frame_rate=30)) == [0, 1, 2, 3]
    assert numbers(read_frames(video, frame_rate=10)) == [0, 3, 6, 9]


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("clip.mp4", "libx264"),
        ("clip.mkv", "libx264"),
        ("clip.ts", "libx264"),
        ("clip.avi", "mpeg4"),
        ("clip.webm", "libvpx"),
    ],
)
def test_times_count_from_the_first_frame_in_every_container(tmp_path, name, codec):
    video = write_video(tmp_path / name, even(25), codec=codec, g="10", b="2000000")
    for start_s in (0, 0.33, 1.0, 1.84):
        footage = read_frames(video, start_s=start_s, frame_rate=25)
        first = round(start_s * 25)
        assert numbers(footage) == list(range(first, first + 4))
        np.testing.assert_allclose(footage.times_s, np.arange(first, first + 4) / 25, atol=1e-3)


def test_a_first_frame_that_is_late_is_time_zero(tmp_path):
    video = write_video(tmp_path / "clip.mkv", even(25, first_ms=3000))
    footage = read_frames(video, start_s=0.2, frame_rate=25)
    assert numbers(footage) == [5, 6, 7, 8]
    assert footage.times_s[0] == pytest.approx(0.2)


def test_a_variable_rate_becomes_an_even_one(tmp_path):
    times_ms = [0, 20, 50, 60, 90, 200, 225, 250, 275, 300]
    video = write_video(tmp_path / "clip.mkv", times_ms)
    footage = read_frames(video)
    np.testing.assert_allclose(footage.times_s, [0, 0.025, 0.05, 0.075], atol=1e-3)
    expected = np.interp(1e3 * footage.times_s, times_ms, range(len(times_ms)))
    np.testing.assert_allclose(places(footage), expected, atol=0.3)
    assert footage.blended_over_s == pytest.approx(0.03)
    assert read_frames(video, start_s=0.09).blended_over_s == pytest.approx(0.11), "a gap"
    assert read_frames(video, start_s=0.2).blended_over_s == 0


def test_frames_at_times_are_blended_like_the_observed_ones_until_the_end(tmp_path):
    video = write_video(tmp_path / "clip.mp4", even(25, frames=20))
    footage = frames_at(video, [0.2, 0.21, 0.4985, 0.761, 0.9])
    np.testing.assert_allclose(footage.times_s, [0.2, 0.21, 0.4985, 0.76], atol=1e-3)
    np.testing.assert_allclose(places(footage), [5, 5.25, 12.46, 19], atol=0.3)
    assert footage.blended_over_s == pytest.approx(0.04)
    with pytest.raises(FootageEndedError, match=r"ends before 0\.900 s"):
        frames_at(video, [0.9])


def test_a_crop_is_that_part_of_the_picture(tmp_path):
    video = write_video(tmp_path / "clip.mp4", even(30))
    whole = read_frames(video)
    assert whole.crop == SquareCrop(16, 0, 64)
    part = read_frames(video, crop=SquareCrop(24, 8, 40))
    np.testing.assert_array_equal(part.frames, whole.frames[:, 8:48, 8:48])
    corner = read_frames(video, crop=SquareCrop(0, 0, 32)).frames[0]
    assert corner[4, 4, 0] > 150 > 50 > corner[4, 24, 0]
    assert corner[4, 4, 1] < 50


def test_pixels_that_are_not_square_are_shown_square(tmp_path):
    stored = write_video(tmp_path / "clip.mp4", even(30, frames=6), pixel_aspect=Fraction(4, 3))
    crop = SquareCrop(64, 0, 64)
    with pytest.raises(CropError):
        read_frames(write_video(tmp_path / "plain.mp4", even(30, frames=6)), crop=crop)
    (shown,) = read_frames(stored, crop=crop).frames[:1]
    # 96 pixels of 4:3 are 128 wide: the darker left half ends at 64.
    assert shown[-8:, :4].mean() == pytest.approx(20, abs=4)
    whole = read_frames(stored, crop=SquareCrop(0, 0, 64)).frames[0]
    assert whole[-8:, -8:].mean() == pytest.approx(4, abs=4)


@pytest.mark.parametrize(
    ("crop", "message"),
    [
        (SquareCrop(40, 0, 64), r"spans x 40\.\.104 and y 0\.\.64, the picture is 96 x 64"),
        (SquareCrop(0, 1, 64), r"y 1\.\.65"),
        (SquareCrop(-1, 0, 32), "x -1"),
        (SquareCrop(0, 0, 0), "crop 0,0,0"),
    ],
)
def test_a_crop_outside_the_picture_is_refused(tmp_path, crop, message):
    video = write_video(tmp_path / "clip.mp4", even(30, frames=5))
    with pytest.raises(CropError, match=message):
        read_frames(video, crop=crop)


@pytest.mark.parametrize("start_s", [0.12, 0.2, 100, 1e9])
def test_a_start_too_near_the_end_or_beyond_is_refused(tmp_path, start_s):
    video = write_video(tmp_path / "clip.mp4", even(25, frames=5))
    with pytest.raises(FootageError, match=r"ends before .* s; 4 frames from .* s do not fit"):
        read_frames(video, start_s=start_s)


@pytest.mark.parametrize("start_s", [-0.1, float("nan"), float("inf")])
def test_a_start_that_is_no_time_is_refused(tmp_path, start_s):
    video = write_video(tmp_path / "clip.mp4", even(25, frames=5))
    with pytest.raises(FootageError, match="expected 0 or later"):
        read_frames(video, start_s=start_s)


def test_a_file_that_cannot_be_sought_in(tmp_path):
    pictures = [Image.fromarray(picture(number)) for number in range(20)]
    pictures[0].save(
        tmp_path / "clip.gif", save_all=True, append_images=pictures[1:], duration=40, loop=0
    )
    footage = read_frames(tmp_path / "clip.gif", start_s=0.4, frame_rate=25)
    assert numbers(footage) == [10, 11, 12, 13]


def test_files_that_are_no_video_are_refused(tmp_path):
    text = tmp_path / "notes.mp4"
    text.write_text("not a video\n" * 100)
    with pytest.raises(FootageError, match=r"notes\.mp4 cannot be read as a video: Invalid data"):
        read_frames(text)
    with pytest.raises(FootageError, match="cannot be read: No such file"):
        read_frames(tmp_path / "nowhere.mp4")
    with pytest.raises(FootageError, match="cannot be read: Is a directory"):
        read_frames(tmp_path)
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(write_video(tmp_path / "clip.mp4", even(30)).read_bytes()[:1000])
    with pytest.raises(FootageError, match=r"cut\.mp4 cannot be read as a video"):
        read_frames(cut)


def test_sound_alone_and_one_picture_are_refused(tmp_path):
    sound = tmp_path / "sound.wav"
    with av.open(sound, "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        samples = np.zeros((1, 800), np.int16)
        frame = av.AudioFrame.from_ndarray(samples, format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.raises(FootageError, match="has no video in it"):
        read_frames(sound)
    Image.fromarray(picture(0)).save(tmp_path / "one.png")
    with pytest.raises(FootageError, match="is one picture"):
        open_clip(tmp_path / "one.png")


def test_a_spacing_needs_two_frames(tmp_path):
    video = write_video(tmp_path / "clip.mp4", even(25, frames=5))
    with pytest.raises(ValueError, match="expected at least 2"):
        read_frames(video, frames=1)
