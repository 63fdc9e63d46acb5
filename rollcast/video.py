"""Frames of a video file by presentation time (extra ``video``).

Times are seconds after the video's first frame. Pictures are turned, and their pixels square, as
players show them.
"""

import math
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from jaxtyping import UInt8

from rollcast.errors import FootageError
from rollcast.footage import (
    RATE_TOLERANCE,
    SNAP,
    Footage,
    SquareCrop,
    TimedFrame,
    between,
    from_moments,
)
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

LOOK_AHEAD = 8
"""Frames after the first by which the distance between frames is measured."""
TIME_TOLERANCE_S = 0.5 / FRAME_RATE_HZ
"""How long after a video's last frame a time still counts as shown by it: half a step."""


class _Shown(NamedTuple):
    time_s: float
    picture: VideoFrame
    pixel_aspect: float
    """Width of a stored pixel by its height, as players show it."""


def read_frames(
    path: Path | str,
    *,
    start_s: float = 0.0,
    frames: int = OBSERVED_FRAMES,
    crop: SquareCrop | None = None,
    frame_rate: float = FRAME_RATE_HZ,
) -> Footage:
    """Read frames that follow each other evenly, from the frame nearest to a start.

    Of a camera whose rate is a multiple of the one asked for, to RATE_TOLERANCE, every m-th frame
    is taken, and the answer's ``frame_rate`` tells the truth. Where the camera took no frame
    (another or a varying rate), one is blended from those before and after; the answer's
    ``blended_over_s`` tells how far apart these are.

    Parameters
    ----------
    path
        Any video that PyAV decodes.
    start_s
        Time of the first frame, seconds.
    frames
        How many, at least two.
    crop
        By default the largest square in the middle.
    frame_rate
        Frames a second that are asked for.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or ends before the last frame that is asked for.
    CropError
        When the crop does not lie inside the picture.
    """
    if frames < 2:
        raise ValueError(f"frames is {frames}, expected at least 2")
    with _opened(path) as container:
        moments = _moments_from(container, path, start_s)
        head = list(islice(moments, 2 + LOOK_AHEAD))
        if len(head) > 1 and head[1].time_s - start_s < start_s - head[0].time_s:
            head.pop(0)
        spacing_s = _spacing([moment.time_s for moment in head], frame_rate)
        wanted = [head[0].time_s + index * spacing_s for index in range(frames)]
        taken = list(_between(chain(head, moments), wanted, SNAP * spacing_s))
        if len(taken) < frames:
            raise FootageError(
                f"{path} ends before {wanted[-1]:.3f} s; {frames} frames from {start_s:g} s do not "
                "fit"
            )
        return from_moments(taken, crop)


def camera_rate(path: Path | str, start_s: float = 0.0) -> float:
    """Return how many frames a second a video has near a time.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or has no two frames there.
    """
    with _opened(path) as container:
        head = list(islice(_moments_from(container, path, start_s), 2 + LOOK_AHEAD))
    if len(head) < 2:
        raise FootageError(f"{path} has one frame from {start_s:g} s on")
    return 1 / _distance([moment.time_s for moment in head])


def frames_at(
    path: Path | str, times_s: Sequence[float], *, crop: SquareCrop | None = None
) -> Footage:
    """Read the frames nearest to some times; the answer holds their real times.

    Parameters
    ----------
    path
        Any video that PyAV decodes.
    times_s
        Ascending, seconds. Those after the last frame are left out, and no frame comes twice, so
        the answer may be shorter.
    crop
        By default the largest square in the middle.

    Raises
    ------
    FootageError
        When the file cannot be read as a video, or ends before the first time.
    CropError
        When the crop does not lie inside the picture.
    """
    with _opened(path) as container:
        moments = _moments_from(container, path, times_s[0])
        taken = list(_nearest(moments, times_s))
        if not taken:
            raise FootageError(f"{path} ends before {times_s[0]:.3f} s")
        shown = [TimedFrame(_pixels(moment), moment.time_s) for moment in taken]
        return from_moments(shown, crop)


def every_frame(path: Path | str) -> Iterator[TimedFrame]:
    """Read all frames of a video, whole, as the camera took them.

    Raises
    ------
    FootageError
        When the file cannot be read as a video.
    """
    with _opened(path) as container:
        for shown in _moments_from(container, path, 0.0):
            yield TimedFrame(_pixels(shown), shown.time_s)


@contextmanager
def _opened(path: Path | str) -> Generator[InputContainer]:
    """Open a file, never an address or a pattern of names, and translate what goes wrong."""
    try:
        with Path(path).open("rb") as file, av.open(file, "r") as container:
            yield container
    except OSError as error:
        raise FootageError(f"{path} cannot be read: {error.strerror}") from error
    except FFmpegError as error:
        raise FootageError(f"{path} cannot be read as a video: {error.strerror}") from error


def _moments_from(container: InputContainer, path: Path | str, start_s: float) -> Iterator[_Shown]:
    """Decode from the last frame at or before a time, in the order of presentation."""
    if not math.isfinite(start_s) or start_s < 0:
        raise FootageError(f"the start is {start_s:g} s, expected 0 or later")
    origin = _first_pts(path)
    stream = _video_stream(container, path)
    if start_s > 0 and stream.time_base is not None:
        with suppress(FFmpegError):  # where a container cannot seek, all of it is decoded
            container.seek(origin + int(start_s / stream.time_base), stream=stream)
    moments = _moments(container, stream, origin)
    before = next(moments, None)
    if before is None or before.time_s > start_s:  # the container's index is poor
        container.seek(origin, stream=stream)
        moments = _moments(container, stream, origin)
        before = next(moments)
    for moment in moments:
        if moment.time_s > start_s:
            return chain([before, moment], moments)
        before = moment
    return iter([before])


def _first_pts(path: Path | str) -> int:
    """Return when a video's first frame is shown, which its header may not tell."""
    with _opened(path) as container:
        for picture in container.decode(_video_stream(container, path)):
            if picture.pts is not None:
                return picture.pts
    raise FootageError(f"{path} has no frame with a time")


def _video_stream(container: InputContainer, path: Path | str) -> VideoStream:
    if not container.streams.video:
        raise FootageError(f"{path} has no video in it")
    return container.streams.video[0]


def _moments(container: InputContainer, stream: VideoStream, origin: int) -> Iterator[_Shown]:
    last_s = -math.inf
    for picture in container.decode(stream):
        if picture.pts is not None and picture.time_base is not None:
            time_s = float((picture.pts - origin) * picture.time_base)
            if time_s > last_s:
                # Zero or nothing means that the file does not tell.
                yield _Shown(time_s, picture, float(stream.sample_aspect_ratio or 1))
                last_s = time_s


def _spacing(times_s: Sequence[float], frame_rate: float) -> float:
    """Return the time between the wanted frames: a multiple of the camera's if that comes near."""
    if len(times_s) < 2:
        return 1 / frame_rate
    distance_s = _distance(times_s)
    spacing_s = max(1, round(1 / (frame_rate * distance_s))) * distance_s
    is_near = abs(spacing_s * frame_rate - 1) <= RATE_TOLERANCE
    return spacing_s if is_near else 1 / frame_rate


def _distance(times_s: Sequence[float]) -> float:
    """Return the time between frames where none is missing; containers round it."""
    distances_s = np.diff(times_s)
    return float(distances_s[distances_s < 1.5 * np.median(distances_s)].mean())


def _between(
    moments: Iterable[_Shown], wanted_s: Sequence[float], near_s: float
) -> Iterator[TimedFrame]:
    """Yield a picture for each of some ascending times, blended where none is near (`between`)."""
    moments = iter(moments)
    before = next(moments, None)
    after = next(moments, None)
    for time_s in wanted_s:
        while before is not None and after is not None and after.time_s < time_s:
            before, after = after, next(moments, None)
        if before is None or (after is None and time_s > before.time_s + near_s):
            return
        last = after or before
        yield between(_pixels(before), before.time_s, _pixels(last), last.time_s, time_s, near_s)


def _nearest(moments: Iterable[_Shown], wanted_s: Sequence[float]) -> Iterator[_Shown]:
    """Yield the frame nearest to each of some ascending times, none twice, until the video ends."""
    moments = iter(moments)
    following = next(moments, None)
    for time_s in wanted_s:
        best, following = following, next(moments, None)
        while (
            best is not None
            and following is not None
            and abs(following.time_s - time_s) <= abs(best.time_s - time_s)
        ):
            best, following = following, next(moments, None)
        if best is None or (following is None and time_s > best.time_s + TIME_TOLERANCE_S):
            return
        yield best


def _pixels(moment: _Shown) -> UInt8[np.ndarray, "height width 3"]:
    """Picture with square pixels, turned as players show it."""
    picture = moment.picture
    shown = picture.reformat(width=round(picture.width * moment.pixel_aspect), format="rgb24")
    return np.rot90(np.asarray(shown.to_ndarray(), np.uint8), picture.rotation // 90)
