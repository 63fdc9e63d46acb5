"""Cameras are read as files are: one loop decodes both."""

import io
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import islice

import av
import numpy as np
import pytest
from PIL import Image

from rollcast.errors import FootageError
from rollcast.video import VideoFile, camera_frames
from tests.rollcast.test_video_kinds import B_FRAMES, FRAMES, SIDE, numbers, picture, write


def mirrored(path):
    write(path)
    data = path.read_bytes()
    one = (1 << 16).to_bytes(4, "big")
    place = data.rindex(one + bytes(12) + one + bytes(12) + (1 << 30).to_bytes(4, "big"))
    path.write_bytes(
        data[:place] + (-(1 << 16)).to_bytes(4, "big", signed=True) + data[place + 4 :]
    )


def damaged(path):
    write(path, options={"g": "4", "bf": "0"})
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    data[packets[15].pos : packets[15].pos + packets[15].size] = b"\xff" * packets[15].size
    path.write_bytes(data)


def interlaced(path):
    def prepare(stream):
        stream.codec_context.flags |= 1 << 18 | 1 << 29

    write(path, "mpeg2video", options={"b": "4000000"}, prepare=prepare)


KINDS = {
    "plain.mp4": write,
    "mirrored.mp4": mirrored,
    "damaged.mp4": damaged,
    "interlaced.ts": interlaced,
    "reordered.avi": lambda path: write(path, options=B_FRAMES),
    "reordered.mkv": lambda path: write(path, options=B_FRAMES),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_camera_gives_the_frames_of_the_same_file(tmp_path, name):
    KINDS[name](tmp_path / name)
    stored = [(frame.time_s, frame.load()) for frame in VideoFile(tmp_path / name).frames()]
    seen = list(camera_frames(str(tmp_path / name)))
    assert len(seen) == len(stored) >= FRAMES - 4
    np.testing.assert_allclose([one.time_s for one in seen], [time_s for time_s, _ in stored])
    for one, (_, pixels) in zip(seen, stored, strict=True):
        np.testing.assert_array_equal(one.picture, pixels)


@pytest.mark.parametrize(("codec", "kind"), [("libx264", "h264"), ("mjpeg", "mjpeg")])
def test_a_camera_without_times_has_those_of_arrival(tmp_path, codec, kind):
    pix = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    path = write(tmp_path / f"clip.{kind}", codec, kind, pix=pix)
    seen = list(camera_frames(str(path)))
    assert len(seen) == FRAMES
    assert (np.diff([one.time_s for one in seen]) > 0).all()


class Mjpeg(BaseHTTPRequestHandler):
    """A network camera that sends ten JPEG files a second, without saying so."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for number in range(16):
            file = io.BytesIO()
            Image.fromarray(picture(number)).save(file, "JPEG")
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {file.tell()}\r\n\r\n"
            with suppress(OSError):  # the test has seen enough
                self.wfile.write(head.encode() + file.getvalue() + b"\r\n")
            time.sleep(0.1)

    def log_message(self, *_):
        """Stay silent."""


def test_the_rate_of_a_network_camera_is_measured():
    server = ThreadingHTTPServer(("127.0.0.1", 0), Mjpeg)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        camera = camera_frames(f"http://127.0.0.1:{server.server_port}/video.mjpg")
        seen = list(islice(camera, 14))
    finally:
        server.shutdown()
        server.server_close()
    assert len(seen) == 14
    times_s = [one.time_s for one in seen[-8:]]
    rate = 7 / (times_s[-1] - times_s[0])
    assert 4 < rate < 14, "ten a second; the machine may have other work"
    assert seen[0].picture.shape == (SIDE, SIDE, 3)


def test_what_is_no_camera_is_refused(tmp_path):
    (tmp_path / "text").write_text("no video")
    with pytest.raises(FootageError, match="cannot be read"):
        list(camera_frames(str(tmp_path / "text")))


def test_joined_recordings_go_on_and_are_told(tmp_path):
    part = write(tmp_path / "a.ts", options={"g": "6"}).read_bytes()
    (tmp_path / "joined.ts").write_bytes(part + part)
    clip = VideoFile(tmp_path / "joined.ts")
    found, times_s = numbers(clip)
    assert found == [*range(FRAMES), *range(FRAMES)]
    np.testing.assert_allclose(times_s, np.arange(2 * FRAMES) / 40, atol=2e-3)
    assert any("jump back at 0.575 s" in warning for warning in clip.warnings), clip.warnings
    assert [one.time_s for one in camera_frames(str(tmp_path / "joined.ts"))] == times_s
    late = [frame.time_s for frame in clip.frames(0.8)]
    assert late == pytest.approx(times_s[32:], abs=1e-6)
    early = [frame.time_s for frame in clip.frames(0.3)]
    assert early == pytest.approx(times_s[12:], abs=1e-6)
