"""``rollcast live``: forecasts over a running picture, on a page of this machine."""

import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
import typer
from jaxtyping import UInt8
from PIL import Image

from rollcast.client import Client
from rollcast.client.pictures import rings_of
from rollcast.commands.mjpeg import LivePage
from rollcast.commands.options import CommandError, Outcome, Url, client, whole_number
from rollcast.errors import ClientError, MissingExtraError
from rollcast.plot import draw_moment
from rollcast.schemas import (
    AUTO_MODEL,
    DEFAULT_HORIZON,
    MAX_HORIZON,
    MAX_RATE_HZ,
    MIN_RATE_HZ,
)
from rollcast.trajectory import OBSERVED_FRAMES

if TYPE_CHECKING:
    from rollcast.video import VideoFile

HELP = """\
Forecast balls in a running picture.

Reads a webcam (its number), a network camera (an rtsp:// or http:// address) or a clip, which is
played at its own speed. The page on this machine shows each forecast over the frame that it starts
from, with the delay since that frame. While a forecast is computed, newer frames replace older
ones. Ends with the clip, or with Ctrl-C.

\b
Examples:
  rollcast live 0
  rollcast live rtsp://192.168.0.5/stream --port 8090
  rollcast live clip.mp4 --horizon 20
"""
SIDE_PX = 640
"""Longer side of the frames that are sent."""
ADDRESSES = ("rtsp://", "http://", "https://")


class LiveFrame(NamedTuple):
    """A frame of a camera."""

    picture: UInt8[np.ndarray, "height width 3"]
    time_s: float
    """Time of exposure by the camera's clock."""
    arrived_s: float
    """Time of arrival by this machine's clock."""


class LatestFrames:
    """The last four frames of a source, which a thread reads as they come."""

    def __init__(self, frames: Iterator[LiveFrame]) -> None:
        self._frames = frames
        self._last: deque[LiveFrame] = deque(maxlen=OBSERVED_FRAMES)
        self._changed = threading.Condition()
        self._error: Exception | None = None
        self.count = 0
        self.ended = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def wait_newer(self, than_s: float) -> list[LiveFrame] | None:
        """Return the last four frames once there is one after a time; None at the end.

        Raises
        ------
        FootageError
            When the source fails.
        """
        with self._changed:
            while not (self._is_newer(than_s) or self.ended):
                self._changed.wait()
            if self._error is not None:
                raise self._error
            return list(self._last) if self._is_newer(than_s) else None

    def _is_newer(self, than_s: float) -> bool:
        return len(self._last) == OBSERVED_FRAMES and self._last[-1].arrived_s > than_s

    def _read(self) -> None:
        try:
            for frame in self._frames:
                with self._changed:
                    self._last.append(frame)
                    self.count += 1
                    self._changed.notify_all()
        except Exception as error:  # raised where the frames are waited for
            self._error = error
        with self._changed:
            self.ended = True
            self._changed.notify_all()


def live(
    context: typer.Context,
    source: Annotated[
        str,
        typer.Argument(metavar="CAMERA|ADDRESS|VIDEO", help="number of a webcam, address or video"),
    ],
    horizon: Annotated[
        int,
        typer.Option(
            parser=whole_number(1, MAX_HORIZON), metavar="STEPS", help="number of steps to forecast"
        ),
    ] = DEFAULT_HORIZON,
    model: Annotated[
        str, typer.Option(metavar="NAME", help="auto, NAME or NAME@VERSION")
    ] = AUTO_MODEL,
    port: Annotated[
        int,
        typer.Option(
            parser=whole_number(0, 2**16 - 1),
            metavar="PORT",
            help="port of the page, 0: a free one",
        ),
    ] = 0,
    url: Url = None,
) -> Outcome:
    """Read the newest four frames again and again, forecast them and show the answer."""
    frames = _frames(source)
    delays_s: list[float] = []
    failures: list[str] = []
    with ExitStack() as opened:
        service = opened.enter_context(client(context, url))
        page = opened.enter_context(_page(port))
        typer.echo(f"Rollcast shows {source} on {page.address}", err=True)
        latest = LatestFrames(frames)
        shown_s = 0.0
        while (seen := latest.wait_newer(shown_s)) is not None:
            shown_s = seen[-1].arrived_s
            try:
                picture, delay_s = _forecast(service, seen, horizon, model)
            except ClientError as error:
                if not delays_s:
                    raise
                failures.append(str(error))
                continue
            delays_s.append(delay_s)
            page.show(picture)
    if not delays_s:
        raise CommandError(f"{source} has fewer than {OBSERVED_FRAMES} frames")
    text = (
        f"{source}: {latest.count} frames, {len(delays_s)} forecasts, median delay "
        f"{1000 * median(delays_s):.0f} ms"
    )
    return Outcome(text, failures[:1])


def _page(port: int) -> LivePage:
    try:
        return LivePage(port)
    except OSError as error:
        raise CommandError(
            f"--port {port} is not free ({error.strerror}): choose another one, or 0 for a free one"
        ) from error


def _forecast(
    service: Client, seen: list[LiveFrame], horizon: int, model: str
) -> tuple[Image.Image, float]:
    span_s = seen[-1].time_s - seen[0].time_s
    frame_rate = (OBSERVED_FRAMES - 1) / max(span_s, (OBSERVED_FRAMES - 1) / MAX_RATE_HZ)
    forecast = service.predict(
        [frame.picture for frame in seen],
        horizon=horizon,
        model=model,
        frame_rate=max(frame_rate, MIN_RATE_HZ),
    )
    delay_s = time.monotonic() - seen[-1].arrived_s
    title = f"{forecast.model.name}: +{forecast.times_s[-1]:.2f} s, delay {1000 * delay_s:.0f} ms"
    end_s = float(forecast.times_s[-1])
    return draw_moment(seen[-1].picture, end_s, forecast, title, rings_of(forecast, -1)), delay_s


def _frames(source: str) -> Iterator[LiveFrame]:
    """Return the frames of a source; opened when the first is read."""
    try:
        from rollcast.video import VideoFile, camera_frames
    except ModuleNotFoundError as error:
        raise MissingExtraError("videos need", "PyAV", "video") from error
    if source.isdecimal() or source.startswith(ADDRESSES):
        return (
            LiveFrame(_small(frame.picture), frame.time_s, time.monotonic())
            for frame in camera_frames(source)
        )
    return _played(VideoFile(Path(source)))


def _played(video: "VideoFile") -> Iterator[LiveFrame]:
    """Yield the frames of a video when they are due."""
    begun_s = time.monotonic()
    for taken in video.frames():
        picture = _small(taken.load())
        time.sleep(max(0.0, begun_s + taken.time_s - time.monotonic()))
        yield LiveFrame(picture, taken.time_s, time.monotonic())


def _small(picture: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    height, width = picture.shape[:2]
    factor = -(-max(height, width) // SIDE_PX)
    return np.asarray(Image.fromarray(picture).reduce(factor)) if factor > 1 else picture
