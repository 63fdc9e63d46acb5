"""Frames of a video file by presentation time (extra ``video``).

Times are seconds after the video's first frame. Pictures are turned and mirrored, deinterlaced,
and their pixels square, as players show them; colours are converted by the tag of the file, and
by BT.601 without a tag.
"""

import math
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain, count, islice, pairwise
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.filter import Graph
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from jaxtyping import UInt8

from rollcast.errors import FootageEndedError, FootageError
from rollcast.footage import (
    Footage,
    PictureCrop,
    TakenFrame,
    TimedFrame,
    rate_near,
    read_at,
    read_evenly,
    usual_distance,
)
from rollcast.frames import as_frame, require_regular_file, shown_path
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

PROBED_FRAMES = 24
"""Number of first frames that are used to check a file's times."""
NO_TIMESTAMPS = 0x80
"""FFmpeg's flag (AVFMT_NOTIMESTAMPS) of elementary streams: they hold pictures and no times."""
PIPES = "_pipe"
"""End of the names of FFmpeg's formats of joined image files, which hold no times."""
UNTIMED = "mpjpeg"
"""FFmpeg's format of cameras that send JPEG files over HTTP; it assumes 25 a second."""
DISCONTINUOUS = 0x200
"""FFmpeg's flag (AVFMT_TS_DISCONT) of formats whose files can be joined, times and all."""
PLACES_NAMED = 3
"""Places in time that a warning names; of more it gives the number."""
PLACES_KEPT = 1000
JUMP_BACK = 4
"""Frames by which times jump back where they begin anew; smaller steps are wrong single times."""
BT2020 = 9
"""Number of FFmpeg's conversion, for which older versions of PyAV have no name."""
COLORSPACES: Mapping[int, str | int] = {
    1: "ITU709",
    4: "FCC",
    7: "SMPTE240M",
    9: BT2020,
    10: BT2020,
}
"""Conversions by a file's tag (AVColorSpace); all other ones are BT.601's."""
UNTAGGED, FULL_RANGE = 0, 2
"""Tags (AVColorRange): unspecified, and full range (0 to 255)."""
LAST_STAMP = 2**62
"""Time stamp beyond which none is sought."""
CAMERA_TIMEOUT_S = 10.0
"""Time without an answer after which a camera counts as not there."""
ROUNDING = 0.05
"""Relative difference between a stated rate and that of rounded timestamps."""


class _Shown(NamedTuple):
    time_s: float
    picture: VideoFrame
    pixel_aspect: float
    """Width of a stored pixel by its height, as players show it."""


class _Probe(NamedTuple):
    """Properties that are derived from the first frames of a file."""

    origin: int
    """Time stamp of the first frame."""
    time_base: float
    """Seconds of the file by unit of its time stamps."""
    scale: float
    """Seconds of the camera by second of the file."""
    interval_s: float | None
    """Seconds between frames, where the file has no times."""
    is_counted: bool
    """Replacement of missing or non-ascending times: the k-th frame gets the k-th time."""
    is_interlaced: bool


class _Damage(NamedTuple):
    stamp: int | None
    packet: int
    """Number of the frame."""


_Timed: TypeAlias = tuple[float, VideoFrame]
T = TypeVar("T")


def read_frames(
    path: Path | str,
    *,
    start_s: float = 0.0,
    frames: int = OBSERVED_FRAMES,
    crop: PictureCrop | None = None,
    frame_rate: float = FRAME_RATE_HZ,
    told_rates: tuple[float, float] | None = None,
    camera_hz: float | None = None,
) -> Footage:
    """Read frames that follow each other evenly (``rollcast.footage.read_evenly``).

    Parameters
    ----------
    path
        Any video that PyAV decodes.
    start_s, frames, crop, frame_rate, told_rates
        As for ``rollcast.footage.read_evenly``.
    camera_hz
        As for :class:`VideoFile`.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or ends before the last frame that is asked for.
    CropError
        When the crop does not lie inside the picture.
    """
    return read_evenly(
        VideoFile(path, camera_hz=camera_hz),
        start_s=start_s,
        frames=frames,
        crop=crop,
        frame_rate=frame_rate,
        told_rates=told_rates,
    )


def camera_rate(path: Path | str, start_s: float = 0.0) -> float:
    """Return how many frames a second a video has near a time.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or has no two frames there.
    """
    return rate_near(VideoFile(path), start_s)


def frames_at(
    path: Path | str,
    times_s: Sequence[float],
    *,
    crop: PictureCrop | None = None,
    frame_rate: float = FRAME_RATE_HZ,
    camera_hz: float | None = None,
) -> Footage:
    """Read the frames of some times, blended where there are none (``rollcast.footage.read_at``).

    Parameters
    ----------
    path
        Any video that PyAV decodes.
    times_s
        Ascending, seconds. Those after the last frame are left out, so the answer may be shorter.
    crop, frame_rate
        As for ``rollcast.footage.read_at``.
    camera_hz
        As for :class:`VideoFile`.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or ends before the first time.
    CropError
        When the crop does not lie inside the picture.
    """
    source = VideoFile(path, camera_hz=camera_hz)
    return read_at(source, times_s, crop=crop, frame_rate=frame_rate)


def every_frame(path: Path | str) -> Iterator[TimedFrame]:
    """Read all frames of a video, whole, as the camera took them.

    Raises
    ------
    FootageError
        When the file cannot be read as a video.
    """
    for taken in VideoFile(path).frames():
        yield TimedFrame(taken.load(), taken.time_s)


def camera_frames(source: str) -> Iterator[TimedFrame]:
    """Yield the frames of a camera as they come.

    Parameters
    ----------
    source
        Number of a webcam (Video4Linux), or the address of a network camera.

    Raises
    ------
    FootageError
        When it cannot be opened or read on.
    """
    camera = _Camera(source)
    for taken in camera.frames():
        yield TimedFrame(taken.load(), taken.time_s)


class _Decoder:
    """Decoded frames of a container at their times: the same for files and cameras."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._damage: set[_Damage] = set()
        self._jumps_s: set[float] = set()
        self._probe = _Probe(0, 1.0, 1.0, None, is_counted=False, is_interlaced=False)

    @property
    def warnings(self) -> list[str]:
        """Faults met so far, a sentence each."""
        messages: list[str] = []
        if self._probe.is_interlaced:
            messages.append(
                f"{self.name} is interlaced: its frames were deinterlaced, so fast motion is "
                "less accurate"
            )
        if self._damage:
            places = [f"{self._time_of(damage):.3f} s" for damage in self._damage]
            messages.append(
                f"{self.name} is damaged at {_listed(places)}: frames are missing there, "
                "and the next ones may show artefacts"
            )
        if self._jumps_s:
            places = [f"{time_s:.3f} s" for time_s in self._jumps_s]
            messages.append(
                f"the times of {self.name} jump back at {_listed(places)}: the next frames are "
                "taken to follow evenly, although another recording may begin there"
            )
        return messages

    def _taken(self, shown: Iterable[_Shown]) -> Iterator[TakenFrame]:
        """Frames of one size; another size raises FootageError when it is loaded."""
        size: tuple[int, int] | None = None
        for moment in shown:
            stored = (moment.picture.width, moment.picture.height)
            size = stored if size is None else size
            if size != stored:
                message = (
                    f"{self.name}: the picture changes from {size[0]} x {size[1]} to "
                    f"{stored[0]} x {stored[1]} at {moment.time_s:.3f} s; split the video there "
                    "and use one part"
                )
                yield TakenFrame(moment.time_s, partial(_refuse, message))
            else:
                yield TakenFrame(moment.time_s, partial(_pixels, moment, self.name))

    def _shown(
        self, pictures: Iterable[VideoFrame], stream: VideoStream, stamps: deque[int]
    ) -> Iterator[_Shown]:
        """Yield decoded pictures at ascending times; a jump back continues evenly."""
        # Zero or nothing means that the file does not tell.
        aspect = float(stream.sample_aspect_ratio or 1)
        last_s, interval_s, ahead_s = -math.inf, math.inf, 0.0
        timed = self._timed(pictures, stamps)
        for time_s, picture in _deinterlaced(timed) if self._probe.is_interlaced else timed:
            if time_s > last_s:  # the time of a single frame was wrong
                ahead_s = 0.0
            if time_s + ahead_s <= last_s - JUMP_BACK * interval_s:
                ahead_s = last_s + interval_s - time_s
                self._note(self._jumps_s, last_s)
            now_s = time_s + ahead_s
            if now_s > last_s:
                yield _Shown(now_s, picture, aspect)
                if not math.isinf(last_s):
                    interval_s = now_s - last_s
                last_s = now_s

    def _timed(self, pictures: Iterable[VideoFrame], stamps: deque[int]) -> Iterator[_Timed]:
        probe = self._probe
        for index, picture in enumerate(pictures):
            if probe.interval_s is not None:
                yield index * probe.interval_s, picture
                continue
            stamp = picture.pts
            if probe.is_counted:
                stamp = stamps.popleft() if stamps else None
            if stamp is not None:
                yield self._seconds(stamp), picture

    def _decoded(
        self, container: InputContainer, stream: VideoStream, stamps: deque[int]
    ) -> Iterator[VideoFrame]:
        """Decode all valid packets; collect decoding times and damaged places."""
        packets = container.demux(stream)
        last: int | None = None
        for index in count():
            packet = None
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                if packet.dts is not None:
                    if not packet.size:  # a frame that the recorder dropped; not the end
                        continue
                    stamps.append(packet.dts)
                    last = packet.dts
                pictures = packet.decode()
            except FFmpegError as error:
                if packet is None:  # the container itself: nothing follows that can be found
                    self._broken(error, _Damage(last, index))
                    return
                if packet.dts is not None and stamps:
                    stamps.pop()
                stamp = packet.pts if packet.pts is not None else packet.dts
                self._note(self._damage, _Damage(stamp, index))
                continue
            yield from pictures

    def _broken(self, error: FFmpegError, place: _Damage) -> None:  # noqa: ARG002
        """Note that the container cannot be read on, or raise."""
        self._note(self._damage, place)

    def _note(self, places: set[T], place: T) -> None:
        if len(places) < PLACES_KEPT:
            places.add(place)

    def _seconds(self, stamp: int) -> float:
        return (stamp - self._probe.origin) * self._probe.time_base * self._probe.scale

    def _time_of(self, damage: _Damage) -> float:
        if self._probe.interval_s is not None:
            return damage.packet * self._probe.interval_s
        return 0.0 if damage.stamp is None else self._seconds(damage.stamp)


class _Camera(_Decoder):
    """A webcam or the address of a network camera, read once."""

    def __init__(self, source: str) -> None:
        self._format = "v4l2" if source.isdecimal() else None
        super().__init__(f"/dev/video{source}" if source.isdecimal() else source)

    def frames(self) -> Iterator[TakenFrame]:
        """Yield the frames as they come.

        Raises
        ------
        FootageError
            When the camera cannot be opened or read on.
        """
        try:
            with av.open(
                self.name, "r", format=self._format, timeout=CAMERA_TIMEOUT_S
            ) as container:
                stream = _video_stream(container, self.name)
                stamps: deque[int] = deque(maxlen=None if _is_reordered(container, stream) else 1)
                pictures = self._decoded(container, stream, stamps)
                first = next(pictures, None)
                if first is None:
                    raise FootageError(f"{self.name} has no frame that can be decoded")
                self._probe = self._probed(container, stream, first, stamps)
                yield from self._taken(self._shown(chain([first], pictures), stream, stamps))
        except (FFmpegError, OSError) as error:
            raise FootageError(f"{self.name} cannot be read: {error.strerror or error}") from error

    def _probed(
        self,
        container: InputContainer,
        stream: VideoStream,
        first: VideoFrame,
        stamps: deque[int],
    ) -> _Probe:
        is_counted = _is_reordered(container, stream)
        origin = stamps[0] if is_counted and stamps else first.pts
        is_timed = _has_times(container) and origin is not None and stream.time_base is not None
        self._begun_s = None if is_timed else time.monotonic()
        if self._begun_s is not None or origin is None or stream.time_base is None:
            return _Probe(0, 1.0, 1.0, None, False, first.interlaced_frame)
        time_base = float(stream.time_base)
        return _Probe(origin, time_base, 1.0, None, is_counted, first.interlaced_frame)

    def _timed(self, pictures: Iterable[VideoFrame], stamps: deque[int]) -> Iterator[_Timed]:
        if self._begun_s is None:
            yield from super()._timed(pictures, stamps)
            return
        for picture in pictures:  # the stream has no times: those of their arrival
            yield time.monotonic() - self._begun_s, picture

    def _broken(self, error: FFmpegError, place: _Damage) -> None:  # noqa: ARG002
        raise error


class VideoFile(_Decoder):
    """A video as a source of frames (``rollcast.footage.FrameSource``).

    Parameters
    ----------
    path
        Any video that PyAV decodes.
    camera_hz
        Frames a second that the camera took, where the file does not tell (an elementary stream)
        or is slow motion, stored at another rate. All times are the camera's then.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or its times are not known.
    """

    def __init__(self, path: Path | str, *, camera_hz: float | None = None) -> None:
        super().__init__(shown_path(path))
        self._path = path
        self._jumps_back: bool | None = None
        """Whether times jump back, once it has been looked for."""
        with _opened(path) as container:
            self._probe = self._probed(container, camera_hz)

    def frames(self, start_s: float = 0.0) -> Iterator[TakenFrame]:
        """Yield the frames from the last one at or before a time on, at ascending times.

        Those of another size than the first raise FootageError when they are loaded.

        Raises
        ------
        FootageError
            When the file cannot be read on.
        """
        yield from self._taken(self._shown_from(start_s))

    def _shown_from(self, start_s: float) -> Iterator[_Shown]:
        with _opened(self._path) as container:
            stream = _video_stream(container, self.name)
            is_sought = self._seek(container, stream, start_s)
            shown = self._all_shown(container, stream)
            before = next(shown, None)
            if is_sought and (before is None or before.time_s > start_s):  # a poor index
                container.seek(self._probe.origin, stream=stream)
                shown = self._all_shown(container, stream)
                before = next(shown, None)
            for moment in shown:
                if before is not None and moment.time_s > start_s:
                    yield before
                before = moment
            if before is not None:
                yield before

    def _all_shown(self, container: InputContainer, stream: VideoStream) -> Iterator[_Shown]:
        stamps: deque[int] = deque(maxlen=None if self._probe.is_counted else 1)
        return self._shown(self._decoded(container, stream, stamps), stream, stamps)

    def _seek(self, container: InputContainer, stream: VideoStream, start_s: float) -> bool:
        """Go to the last key frame at or before a time; False where all of it is decoded."""
        if start_s <= 0 or self._probe.is_counted or stream.time_base is None:
            return False
        stamp = self._probe.origin + start_s / self._probe.scale / float(stream.time_base)
        if stamp >= LAST_STAMP:
            raise FootageEndedError(f"{self.name} ends before {start_s:g} s")
        if container.format.flags & DISCONTINUOUS and self._has_jumps():
            return False
        with suppress(FFmpegError):  # where a container cannot seek
            container.seek(int(stamp), stream=stream)
            return True
        return False

    def _has_jumps(self) -> bool:
        """Return whether times jump back, as in joined files, where none can be sought."""
        if self._jumps_back is None:
            with _opened(self._path) as container:
                packets = container.demux(_video_stream(container, self.name))
                stamps: list[int] = []
                with suppress(FFmpegError):  # damaged further on
                    stamps += (packet.dts for packet in packets if packet.dts is not None)
            self._jumps_back = not _ascending(stamps)
        return self._jumps_back

    def _probed(self, container: InputContainer, camera_hz: float | None) -> _Probe:
        """Decode the first frames and judge the times that they have."""
        stream = _video_stream(container, self.name)
        stamps: deque[int] = deque()
        shown: list[int | None] = []
        is_interlaced = False
        for picture in islice(self._decoded(container, stream, stamps), PROBED_FRAMES):
            shown.append(picture.pts)
            is_interlaced |= picture.interlaced_frame
        if not shown:
            raise FootageError(
                f"{self.name} cannot be read as a video: no frame of it can be decoded"
            )
        known = [stamp for stamp in shown if stamp is not None]
        is_reordered = _is_reordered(container, stream)
        is_counted = is_reordered or len(known) < len(shown) or not _ascending(known)
        if is_counted:
            known = list(stamps)[: len(shown)]
        is_timed = _has_times(container) and len(known) == len(shown)
        if is_timed and stream.time_base is not None:
            probe = _Probe(known[0], float(stream.time_base), 1.0, None, is_counted, is_interlaced)
            return probe if camera_hz is None else _rescaled(probe, known, stream, camera_hz)
        if camera_hz is None:
            raise FootageError(
                f"{self.name} holds no times, as a camera's elementary stream: pass the camera's "
                "frame rate (--rate in the shell, camera_hz= in Python)"
            )
        return _Probe(0, 1.0, 1.0, 1 / camera_hz, True, is_interlaced)


@contextmanager
def _opened(path: Path | str) -> Generator[InputContainer]:
    """Open a file, never an address or a pattern of names, and translate errors."""
    name = shown_path(path)
    try:
        require_regular_file(path)
        if not Path(path).stat().st_size:
            raise FootageError(f"{name} cannot be read as a video: it is empty")
        with (
            Path(path).open("rb") as file,
            av.open(file, "r", metadata_errors="replace") as container,
        ):
            yield container
    except FFmpegError as error:
        raise FootageError(f"{name} cannot be read as a video: {error.strerror}") from error
    except OSError as error:
        raise FootageError(f"{name} cannot be read: {error.strerror}") from error


def _video_stream(container: InputContainer, name: str) -> VideoStream:
    """Return the stream that players show: not the thumbnail beside it."""
    stream = container.streams.best("video")
    if not isinstance(stream, VideoStream):
        raise FootageError(f"{name} has no video in it")
    return stream


def _is_reordered(container: InputContainer, stream: VideoStream) -> bool:
    """Return whether presentation times are wrong: AVI stores none, and FFmpeg guesses them."""
    return container.format.name == "avi" and not stream.codec_context.codec.intra_only


def _has_times(container: InputContainer) -> bool:
    """Return whether the container tells when frames were taken."""
    name = container.format.name
    return not (container.format.flags & NO_TIMESTAMPS or name == UNTIMED or name.endswith(PIPES))


def _listed(places: Iterable[str]) -> str:
    ordered = sorted(set(places))
    more = len(ordered) - PLACES_NAMED
    return f"{', '.join(ordered[:PLACES_NAMED])}{f' and {more} more places' if more > 0 else ''}"


def _ascending(stamps: Sequence[int]) -> bool:
    return all(before < after for before, after in pairwise(stamps))


def _rescaled(
    probe: _Probe, stamps: Sequence[int], stream: VideoStream, camera_hz: float
) -> _Probe:
    """Stretch the file's times, so that its frames come at the camera's rate."""
    if len(stamps) < 2:
        return probe
    interval_s = usual_distance([stamp * probe.time_base for stamp in stamps])
    average_rate = stream.average_rate
    if average_rate and abs(float(average_rate) * interval_s - 1) < ROUNDING:
        interval_s = 1 / float(average_rate)  # exact, where the time stamps are rounded
    return probe._replace(scale=1 / (interval_s * camera_hz))


def _deinterlaced(timed: Iterator[_Timed]) -> Iterator[_Timed]:
    """Make whole pictures of interlaced ones; the filter gives one for each, in order."""
    times_s: deque[float] = deque()
    graph: Graph | None = None
    for time_s, picture in timed:
        if graph is None:
            graph = _deinterlacer(picture)
        times_s.append(time_s)
        graph.push(picture)
        yield from _pulled(graph, times_s)
    if graph is not None:
        graph.push(None)
        yield from _pulled(graph, times_s)


def _deinterlacer(picture: VideoFrame) -> Graph:
    graph = Graph()
    source = graph.add_buffer(
        width=picture.width,
        height=picture.height,
        format=picture.format,
        time_base=picture.time_base,
    )
    deinterlacer = graph.add("bwdif", "mode=send_frame:deint=interlaced")
    sink = graph.add("buffersink")
    source.link_to(deinterlacer)
    deinterlacer.link_to(sink)
    graph.configure()
    return graph


def _pulled(graph: Graph, times_s: deque[float]) -> Iterator[_Timed]:
    while times_s:
        try:
            picture = graph.pull()
        except (BlockingIOError, EOFError):
            return
        if isinstance(picture, VideoFrame):
            yield times_s.popleft(), picture


def _pixels(shown: _Shown, name: str) -> UInt8[np.ndarray, "height width 3"]:
    """Picture with square pixels, turned as players show it."""
    picture = shown.picture
    has_alpha = any(component.is_alpha for component in picture.format.components)
    try:
        # Explicit, because versions of PyAV have different defaults.
        rgb = picture.reformat(
            width=round(picture.width * shown.pixel_aspect),
            format="rgba" if has_alpha else "rgb24",
            src_colorspace=COLORSPACES.get(picture.colorspace, "ITU601"),
            dst_colorspace="ITU601",
            src_color_range="JPEG" if _is_full_range(picture) else "MPEG",
            dst_color_range="JPEG",
        ).to_ndarray()
    except (FFmpegError, ValueError) as error:
        raise FootageError(
            f"{name}: the frame at {shown.time_s:.3f} s ({picture.format.name}) cannot be "
            f"converted to RGB: {error}"
        ) from error
    pixels = np.asarray(rgb, np.uint8)
    return _turned(as_frame(pixels) if has_alpha else pixels, picture)


def _refuse(message: str) -> UInt8[np.ndarray, "height width 3"]:
    raise FootageError(message)


def _is_full_range(picture: VideoFrame) -> bool:
    """Return whether black is 0 and white 255; untagged YUV has a narrower range, grey has not."""
    if picture.color_range == UNTAGGED:
        return picture.format.name.startswith(("gray", "yuvj"))
    return picture.color_range == FULL_RANGE


def _turned(
    pixels: UInt8[np.ndarray, "height width 3"], picture: VideoFrame
) -> UInt8[np.ndarray, "height width 3"]:
    """Turn and mirror a picture by its display matrix, to the nearest of the eight ways."""
    try:
        matrix = picture.side_data.get("DISPLAYMATRIX")
    except ValueError:  # side data of a kind that PyAV does not know, such as EXIF
        return np.rot90(pixels, round(picture.rotation / 90))
    if matrix is None:
        return pixels
    # A row vector (x, y, 1) of the stored picture times this is where players show it.
    to_right, to_down = np.frombuffer(bytes(matrix), np.int32).reshape(3, 3)[:2, :2].T
    if abs(to_right[1]) > abs(to_right[0]):
        pixels, to_right, to_down = pixels.swapaxes(0, 1), to_right[::-1], to_down[::-1]
    rows = -1 if to_down[1] < 0 else 1
    columns = -1 if to_right[0] < 0 else 1
    return pixels[::rows, ::columns]
