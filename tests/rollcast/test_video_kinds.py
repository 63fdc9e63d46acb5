"""Videos as cameras and recorders really write them; each is made here.

A white square of SQUARE pixels moves right by STEP pixels a frame over black, so that a frame tells
its number by where the square is.
"""

import io
import os
import struct
from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.clip import open_clip
from rollcast.errors import FootageError
from rollcast.footage import read_evenly
from rollcast.frames import as_frame
from rollcast.image_sequence import ImageSequence, image_files, numbering_warnings
from rollcast.video import VideoFile, read_frames

SIDE, SQUARE, STEP, ROW = 128, 16, 4, 24
FRAMES = 24
B_FRAMES = {"bf": "2", "g": "12", "b_strategy": "0"}


def picture(number, side=SIDE):
    frame = np.zeros((side, side, 3), np.uint8)
    frame[ROW : ROW + SQUARE, STEP * number : STEP * number + SQUARE] = 255
    return frame


def encode(container, stream, pictures):
    for number, frame in enumerate(pictures):
        made = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format=stream.pix_fmt)
        made.pts, made.time_base = number, Fraction(1, 40)
        container.mux(stream.encode(made))
    container.mux(stream.encode())


def write(
    path, codec="libx264", kind=None, pictures=None, options=None, prepare=None, pix="yuv420p"
):
    pictures = [picture(number) for number in range(FRAMES)] if pictures is None else pictures
    with av.open(str(path), "w", format=kind) as container:
        stream = container.add_stream(codec, rate=40, options=options or {})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pix
        if prepare is not None:
            prepare(stream)
        encode(container, stream, pictures)
    return path


def numbers(source):
    """Number of each frame by the place of its square, and its time."""
    taken = [(frame.time_s, frame.load()) for frame in source.frames()]
    lefts = [np.flatnonzero(shown[ROW + SQUARE // 2, :, 1] > 128)[0] for _, shown in taken]
    return [round(left / STEP) for left in lefts], [time_s for time_s, _ in taken]


def assert_whole(source, rate=40):
    found, times_s = numbers(source)
    assert found == list(range(FRAMES))
    np.testing.assert_allclose(times_s, np.arange(FRAMES) / rate, atol=1e-3)
    assert source.warnings == []


@pytest.mark.parametrize(
    ("name", "kind"),
    [("clip.MP4", "mp4"), ("clip.MTS", "mpegts"), ("clip.mov", "mov"), ("clip", "matroska"),
     ("clip.txt", "mp4"), ("clip.avi", "avi")],
)  # fmt: skip
def test_the_content_decides_and_not_the_name(tmp_path, name, kind):
    assert_whole(open_clip(write(tmp_path / name, kind=kind, options=B_FRAMES)))


def test_frames_that_avi_stores_in_another_order_keep_their_times_from_any_start(tmp_path):
    clip = VideoFile(write(tmp_path / "clip.avi", options=B_FRAMES))
    footage = read_evenly(clip, start_s=0.3)
    lefts = [np.flatnonzero(one[ROW + SQUARE // 2, :, 1] > 128)[0] for one in footage.frames]
    assert [round(left / STEP) for left in lefts] == [12, 13, 14, 15]


@pytest.mark.parametrize(("codec", "kind"), [("libx264", "h264"), ("mjpeg", "mjpeg")])
def test_an_elementary_stream_needs_its_rate(tmp_path, codec, kind):
    pix = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    path = write(tmp_path / f"clip.{kind}", codec, kind, pix=pix)
    with pytest.raises(FootageError, match=r"holds no times.*--rate in the shell"):
        open_clip(path)
    assert_whole(open_clip(path, rate=120), rate=120)


def test_slow_motion_has_the_cameras_times(tmp_path):
    assert_whole(open_clip(write(tmp_path / "clip.mp4"), rate=120), rate=120)


def exif_jpeg(pixels, orientation):
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = orientation, "Camera"
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", exif=exif, quality=95)
    return file.getvalue()


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
@pytest.mark.parametrize("kind", ["mjpeg", "avi", "mov", "matroska"])
def test_motion_jpeg_with_exif_is_read_and_turned(tmp_path, kind, orientation, turns):
    path = tmp_path / "clip"
    stored = np.rot90(picture(2), -turns)  # what the camera's sensor saw
    with av.open(path, "w", format=kind) as container:
        stream = container.add_stream("mjpeg", rate=40)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "yuvj420p"
        for number in range(8):
            packet = av.Packet(exif_jpeg(stored, orientation))
            packet.pts = packet.dts = number
            packet.time_base, packet.stream = Fraction(1, 40), stream
            packet.is_keyframe = True
            container.mux(packet)
    shown = [frame.load() for frame in VideoFile(path, camera_hz=40).frames()]
    assert len(shown) == 8
    for frame in shown:
        assert np.abs(frame.astype(int) - picture(2)).max() < 60


def test_a_thumbnail_is_not_the_video(tmp_path):
    path = tmp_path / "clip.mkv"
    with av.open(path, "w") as container:
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 64, 64, "yuvj420p"
        stream = container.add_stream("libx264", rate=40)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "yuv420p"
        encode(container, cover, [np.full((64, 64, 3), 99, np.uint8)])
        encode(container, stream, [picture(number) for number in range(FRAMES)])
    assert_whole(open_clip(path))


def test_what_is_interlaced_is_deinterlaced_and_told(tmp_path):
    # The lower half picture is of half a frame later, and the square moves fast.
    frames = []
    for number in range(FRAMES):
        frame = picture(number)
        frame[1::2] = picture(number + 1)[1::2]
        frames.append(frame)

    def prepare(stream):
        stream.codec_context.flags |= 1 << 18 | 1 << 29  # interlaced DCT and motion

    clip = open_clip(write(tmp_path / "clip.ts", "mpeg2video", pictures=frames,
                           options={"b": "4000000"}, prepare=prepare))  # fmt: skip
    assert "is interlaced" in clip.warnings[0]
    taken = [frame.load()[..., 1].astype(int) for frame in clip.frames()]
    assert len(taken) == FRAMES
    inside = taken[8][ROW + 2 : ROW + SQUARE - 2]
    stored = frames[8][ROW + 2 : ROW + SQUARE - 2, :, 1].astype(int)
    assert np.abs(np.diff(inside, axis=0)).mean() < 0.5 * np.abs(np.diff(stored, axis=0)).mean()


def test_a_damaged_packet_is_passed_over_and_told(tmp_path):
    path = write(tmp_path / "clip.mp4", options={"g": "4", "bf": "0"})
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    hurt = packets[15]
    data[hurt.pos : hurt.pos + hurt.size] = b"\xff" * hurt.size
    path.write_bytes(data)
    clip = open_clip(path)
    found, _ = numbers(clip)
    assert found[:15] == list(range(15))
    assert found[-4:] == list(range(FRAMES - 4, FRAMES))
    assert "is damaged at 0.375 s" in clip.warnings[0]


def test_a_size_that_changes_is_told(tmp_path):
    parts = [
        write(tmp_path / f"{side}.h264", kind="h264", pictures=[picture(n, side) for n in range(8)])
        for side in (128, 96)
    ]
    joined = tmp_path / "clip.h264"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    clip = open_clip(joined, rate=40)
    with pytest.raises(FootageError, match=r"changes from 128 x 128 to 96 x 96 at 0\.200 s; split"):
        read_evenly(clip, frames=9)
    assert read_evenly(clip).frames.shape == (4, 128, 128, 3)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
def test_pictures_are_turned_and_mirrored_as_their_display_matrix_says(
    tmp_path, quarters, mirrored
):
    frames = np.zeros((8, 64, 96, 3), np.uint8)
    frames[:, :16, :24] = 255
    frames[:, -16:, :24] = 128
    path = write(tmp_path / "clip.mp4", pictures=list(frames))
    turn = [(1, 0, 0, 1), (0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)][quarters]
    a, b, c, d = turn if not mirrored else (-turn[0], turn[1], -turn[2], turn[3])
    one = 1 << 16
    matrix = struct.pack(">9i", a * one, b * one, 0, c * one, d * one, 0, 0, 0, 1 << 30)
    identity = struct.pack(">9i", one, 0, 0, 0, one, 0, 0, 0, 1 << 30)
    data = path.read_bytes()
    place = data.rindex(identity)  # the track's; the movie's comes first
    path.write_bytes(data[:place] + matrix + data[place + len(matrix) :])
    shown = next(open_clip(path).frames()).load()[..., 1].astype(int)

    # Where players show the stored picture's corners: (x, y) times the matrix, about the middle.
    def corner(x, y):
        right, down = a * x + c * y, b * x + d * y
        return shown[4 if down < 0 else -5, 4 if right < 0 else -5]

    assert shown.shape == ((96, 64) if quarters % 2 else (64, 96))
    assert corner(-1, -1) > 240
    assert 100 < corner(-1, 1) < 156
    assert corner(1, -1) < 16 > corner(1, 1)


@pytest.mark.parametrize(
    ("tag", "space"), [(1, "ITU709"), (5, "ITU601"), (6, "ITU601"), (9, 9), (10, 9)]
)
def test_colors_are_those_of_the_files_tag(tmp_path, tag, space):
    color = np.array([200, 60, 30], np.uint8)
    path = tmp_path / "clip.mp4"
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=40, options={"crf": "1"})
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        stream.codec_context.colorspace = tag
        for _ in range(8):
            rgb = av.VideoFrame.from_ndarray(np.tile(color, (64, 64, 1)), format="rgb24")
            container.mux(
                stream.encode(
                    rgb.reformat(
                        format="yuv420p",
                        src_colorspace="ITU601",
                        dst_colorspace=space,
                        src_color_range="JPEG",
                        dst_color_range="MPEG",
                    )
                )
            )
        container.mux(stream.encode())
    shown = next(open_clip(path).frames()).load()[32, 32].astype(int)
    assert np.abs(shown - color).max() <= 4, shown


def test_pipes_devices_and_empty_files_are_refused_at_once(tmp_path):
    pipe = tmp_path / "clip.mp4"
    os.mkfifo(pipe)
    with pytest.raises(FootageError, match=r"is a pipe.*write it to a regular file first"):
        open_clip(pipe)
    with pytest.raises(FootageError, match="is a device"):
        read_frames("/dev/zero")
    (tmp_path / "empty.mp4").touch()
    with pytest.raises(FootageError, match="cannot be read as a video"):
        open_clip(tmp_path / "empty.mp4")


def test_a_start_beyond_all_time_stamps_is_refused(tmp_path):
    with pytest.raises(FootageError, match="ends before"):
        read_frames(write(tmp_path / "clip.mp4"), start_s=1e15)


def test_a_name_that_is_not_utf8(tmp_path):
    path = tmp_path / os.fsdecode(b"clip\xff.mp4")
    path.write_bytes(write(tmp_path / "clip.mp4").read_bytes())
    assert_whole(open_clip(path))
    path.write_bytes(b"no video")
    with pytest.raises(FootageError, match=r"clip\\xff\.mp4 cannot be read") as caught:
        open_clip(path)
    str(caught.value).encode()


def save(folder, names, first=0):
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names, first):
        Image.fromarray(picture(number)).save(folder / name, "PNG")
    return folder


def test_images_come_by_number_and_hidden_ones_and_others_are_passed_over(tmp_path):
    folder = save(tmp_path / "a", [f"frame{number}.png" for number in range(FRAMES)])
    for name in ("._frame0.png", ".DS_Store", "notes.txt", "truth.csv"):
        (folder / name).write_bytes(b"\0\5\x16\7")
    assert_whole(ImageSequence.from_folder(folder, 40))


def test_an_image_is_known_by_its_content_too(tmp_path):
    folder = save(tmp_path / "a", [f"{number}.dat" for number in range(FRAMES)])
    assert_whole(ImageSequence.from_folder(folder, 40))


def test_digits_of_other_scripts_are_text(tmp_path):
    names = ["²1.png", "a2.png", "b3.png", "٣.png"]
    folder = save(tmp_path / "a", names)
    assert [path.name for path in image_files(folder)] == ["a2.png", "b3.png", "²1.png", "٣.png"]


@pytest.mark.parametrize("unit", [1, 10])
def test_a_gap_in_the_numbers_is_time_and_told(tmp_path, unit):
    kept = [0, 1, 2, 5, 6, 7, 8]
    folder = tmp_path / "a"
    for number in kept:
        save(folder, [f"cam1_{unit * number:04}.png"], number)
    clip = ImageSequence.from_folder(folder, 40)
    found, times_s = numbers(clip)
    assert found == kept
    np.testing.assert_allclose(times_s, np.array(kept) / 40)
    [warning] = clip.warnings
    assert "2 images are missing" in warning
    assert f"after cam1_{2 * unit:04}.png" in warning
    footage = read_evenly(clip)
    np.testing.assert_allclose(footage.times_s, np.arange(4) / 40)
    assert footage.warnings == (warning,)


@pytest.mark.parametrize(
    "names",
    [["33.png", "66.png", "100.png", "133.png", "166.png"],  # times of a camera, milliseconds
     ["day1_3.png", "day2_7.png", "day3_1.png", "day4_2.png"]],
)  # fmt: skip
def test_numbers_that_count_no_images_leave_no_gaps(tmp_path, names):
    clip = ImageSequence.from_folder(save(tmp_path / "a", names), 40)
    assert clip.numbers == list(range(len(names)))
    assert clip.warnings == []


@pytest.mark.parametrize(
    ("pattern", "others"),
    [("f{:04}.png", ["calibration.png"]), ("f{:04}.png", ["f3_copy.png", "zz.png"]),
     ("t{:04}_{:04}.png", []), ("12-00-{:02}_{:04}.png", ["first.png"])],
)  # fmt: skip
def test_a_gap_is_seen_beside_other_names_and_numbers(tmp_path, pattern, others):
    kept = [0, 1, 2, 5, 6, 7, 8]
    folder = tmp_path / "a"
    for number in kept:
        save(folder, [pattern.format(*([7 * number, number] if "_" in pattern else [number]))])
    save(folder, others)
    clip = ImageSequence.from_folder(folder, 40)
    of_pattern = [
        number
        for number, path in zip(clip.numbers, image_files(folder), strict=True)
        if path.name not in others
    ]
    assert np.diff(of_pattern).tolist().count(1) >= 4
    assert np.diff(of_pattern).max() == 3
    assert any("2 images are missing" in warning for warning in clip.warnings)
    assert all(any(name in warning for warning in clip.warnings) for name in others)


def test_uneven_numbers_without_a_rule_are_told(tmp_path):
    names = ["33.png", "66.png", "100.png", "200.png", "233.png"]
    clip = ImageSequence.from_folder(save(tmp_path / "a", names), 40)
    assert clip.numbers == list(range(5))
    [warning] = clip.warnings
    assert "33 to 100 apart" in warning


def test_images_named_out_of_order_are_told(tmp_path):
    folder = save(tmp_path / "a", ["frame1.png", "frame10.png", "frame2.png", "frame3.png"])
    clip = open_clip(sorted(folder.iterdir()))
    assert "not the order of their numbers" in clip.warnings[0]


def test_only_the_images_that_are_needed_are_read(tmp_path):
    folder = save(tmp_path / "a", [f"{number}.png" for number in range(FRAMES)])
    for number in range(6, FRAMES):
        (folder / f"{number}.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    clip = ImageSequence.from_folder(folder, 40)
    assert read_evenly(clip).frames.shape == (4, SIDE, SIDE, 3)
    with pytest.raises(FootageError, match=r"6\.png"):
        read_evenly(clip, frames=8)


def test_the_pages_of_a_tiff_file_are_frames(tmp_path):
    first, *rest = [Image.fromarray(picture(number)) for number in range(FRAMES)]
    first.save(tmp_path / "stack.tif", save_all=True, append_images=rest)
    assert_whole(open_clip(tmp_path / "stack.tif", rate=120), rate=120)


def test_names_with_enormous_numbers_are_compared_as_whole_numbers():
    names = [f"{2**63 + step}.png" for step in (0, 1, 4)] + [f"{10**200}.png"]
    assert "apart" in numbering_warnings(names)[0]
    assert "order of their numbers" in numbering_warnings([f"{2**63}.png", "5.png"])[0]
    assert numbering_warnings([]) == numbering_warnings(["a.png"]) == []


@pytest.mark.parametrize(("name", "kind"), [("one.png", "PNG"), ("one.jpg", "JPEG")])
def test_one_picture_is_no_clip(tmp_path, name, kind):
    Image.fromarray(picture(0)).save(tmp_path / name, kind)
    with pytest.raises(FootageError, match=r"is one picture, expected a video, a folder"):
        open_clip(tmp_path / name)
    (tmp_path / "one.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(99))
    with pytest.raises(FootageError, match=r"is one picture, expected a video, a folder"):
        open_clip(tmp_path / "one.heic")


def test_joined_image_files_need_a_rate(tmp_path):
    for number in range(FRAMES):
        Image.fromarray(picture(number)).save(tmp_path / f"{number}.png")
    joined = tmp_path / "clip.bin"
    joined.write_bytes(b"".join((tmp_path / f"{n}.png").read_bytes() for n in range(FRAMES)))
    with pytest.raises(FootageError, match=r"holds no times.*--rate in the shell"):
        open_clip(joined)
    assert_whole(open_clip(joined, rate=40))


def test_transparent_video_is_on_white_as_pictures_are(tmp_path):
    path = tmp_path / "clip.mov"
    with av.open(path, "w") as container:
        stream = container.add_stream("qtrle", rate=40)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "argb"
        for number in range(8):
            rgba = np.dstack([picture(number), np.where(picture(number)[..., 0] > 0, 255, 0)])
            made = av.VideoFrame.from_ndarray(rgba.astype(np.uint8), format="rgba")
            made.pts, made.time_base = number, Fraction(1, 40)
            container.mux(stream.encode(made.reformat(format="argb")))
        container.mux(stream.encode())
    shown = next(VideoFile(path).frames()).load()
    Image.fromarray(rgba.astype(np.uint8)).save(tmp_path / "frame.png")
    assert (shown == 255).all(), "white on white"
    assert (as_frame(tmp_path / "frame.png") == 255).all()
