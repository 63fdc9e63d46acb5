"""Frames cut out of footage, with their times; one resampler for footage of every kind.

A source of frames is a video (``rollcast.video``) or a sequence of images
(``rollcast.image_sequence``); the functions here read evenly timed frames from either.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float64, UInt8

from rollcast.errors import CropError, FootageEndedError, FootageError
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

RATE_TOLERANCE = 0.05
"""Relative difference between rates that counts as none."""
SNAP = 0.1
"""Share of the time between two frames by which one of them may come early or late."""
LOOK_AHEAD = 8
"""Frames after the first by which the distance between frames is measured."""


@dataclass(frozen=True)
class SquareCrop:
    """A square of a picture.

    Attributes
    ----------
    x, y
        Columns left of it and rows above it, pixels.
    size
        Side, pixels.
    """

    x: int
    y: int
    size: int

    @classmethod
    def centred(cls, width: int, height: int) -> "SquareCrop":
        """Return the largest square in the middle of a picture."""
        size = min(width, height)
        return cls((width - size) // 2, (height - size) // 2, size)

    def cut(self, picture: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "S S 3"]:
        """Return a copy of the square.

        Raises
        ------
        CropError
            When it does not lie inside the picture.
        """
        height, width = picture.shape[:2]
        right, bottom = self.x + self.size, self.y + self.size
        if self.size < 1 or self.x < 0 or self.y < 0 or right > width or bottom > height:
            raise CropError(
                f"the crop {self.x},{self.y},{self.size} spans x {self.x}..{right} and "
                f"y {self.y}..{bottom}, the picture is {width} x {height}"
            )
        return picture[self.y : bottom, self.x : right].copy()


@dataclass(frozen=True)
class WholePicture:
    """All of a picture, where a square of it could be."""

    x: int = 0
    """Columns left of it, pixels."""
    y: int = 0
    """Rows above it, pixels."""

    def cut(
        self, picture: UInt8[np.ndarray, "height width 3"]
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a copy of the picture."""
        return picture.copy()


PictureCrop: TypeAlias = SquareCrop | WholePicture
"""Part of a picture that frames show."""


@dataclass(frozen=True)
class Footage:
    """Frames of one size and when they were taken."""

    frames: UInt8[np.ndarray, "frames height width 3"]
    """RGB; square unless they are whole pictures."""
    times_s: Float64[np.ndarray, " frames"]
    """Seconds after the first frame of the whole footage."""
    crop: PictureCrop
    """Part of the picture that the frames show."""
    blended_over_s: float = 0.0
    """Longest time between two frames of the camera that one of these is blended from; 0 when all
    are as the camera took them."""
    warnings: tuple[str, ...] = ()
    """Faults of the file that were met while it was read, a sentence each."""

    @property
    def frame_rate(self) -> float:
        """Frames a second, on average."""
        return (len(self.times_s) - 1) / float(self.times_s[-1] - self.times_s[0])

    def part(self, index: slice | Sequence[int]) -> "Footage":
        """Return some of the frames."""
        return replace(self, frames=self.frames[index], times_s=self.times_s[index])

    def resampled(self, frame_rate: float, count: int) -> "Footage":
        """Return some frames at even times from the first one on (:func:`resample`).

        Raises
        ------
        FootageEndedError
            When the footage ends before the last of them.
        """
        wanted_s = (float(self.times_s[0]) + np.arange(count) / frame_rate).tolist()
        taken = (
            TakenFrame(time_s, lambda index=index: self.frames[index])
            for index, time_s in enumerate(self.times_s.tolist())
        )
        made = list(resample(taken, wanted_s, SNAP / frame_rate))
        if len(made) < count:
            raise FootageEndedError(
                f"the frames end after {self.times_s[-1]:.3f} s; {count} frames, {frame_rate:g} a "
                f"second, need {wanted_s[-1]:.3f} s"
            )
        return replace(from_moments(made, WholePicture()), crop=self.crop)


@dataclass(frozen=True)
class TimedFrame:
    """A picture and when it was taken, or would have been."""

    picture: UInt8[np.ndarray, "height width 3"]
    time_s: float
    blended_over_s: float = 0.0
    """Time between the two pictures that it is blended from; 0 when it was taken."""


class TakenFrame(NamedTuple):
    """A frame that a camera took; its picture is decoded when it is loaded."""

    time_s: float
    load: Callable[[], UInt8[np.ndarray, "height width 3"]]


class FrameSource(Protocol):
    """Footage that is read frame by frame."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    @property
    def warnings(self) -> list[str]:
        """Faults met so far, a sentence each."""
        ...

    def frames(self, start_s: float = 0.0) -> Iterator[TakenFrame]:
        """Yield the frames from the last one at or before a time on, at ascending times."""
        ...


def read_evenly(
    source: FrameSource,
    *,
    start_s: float = 0.0,
    frames: int = OBSERVED_FRAMES,
    crop: PictureCrop | None = None,
    frame_rate: float = FRAME_RATE_HZ,
    told_rates: tuple[float, float] | None = None,
) -> Footage:
    """Read frames that follow each other evenly, from the frame nearest to a start.

    Of a camera whose rate is a multiple of the one asked for, to RATE_TOLERANCE, or comes nearest
    to it within ``told_rates``, every m-th frame is taken, and the answer's ``frame_rate`` tells
    the truth. Where the camera took no frame (another or a varying rate), one is blended from those
    before and after; the answer's ``blended_over_s`` tells how far apart these are.

    Parameters
    ----------
    start_s
        Time of the first frame, seconds.
    frames
        How many, at least two.
    crop
        By default the largest square in the middle.
    frame_rate
        Frames a second that are asked for.
    told_rates
        Lowest and highest rate of a model that is told the rate of its frames.

    Raises
    ------
    FootageEndedError
        When the footage ends before the last frame that is asked for.
    FootageError
        When it cannot be read.
    CropError
        When the crop does not lie inside the picture.
    """
    if frames < 2:
        raise ValueError(f"frames is {frames}, expected at least 2")
    taken = source.frames(_checked(start_s))
    head = list(islice(taken, 2 + LOOK_AHEAD))
    if not head:
        raise FootageEndedError(f"{source.name} has no frames, expected a video or images")
    if len(head) > 1 and head[1].time_s - start_s < start_s - head[0].time_s:
        head.pop(0)
    spacing_s = _spacing([frame.time_s for frame in head], frame_rate, told_rates)
    wanted = [head[0].time_s + index * spacing_s for index in range(frames)]
    made = list(resample(chain(head, taken), wanted, SNAP * spacing_s))
    if len(made) < frames:
        raise FootageEndedError(
            f"{source.name} ends before {wanted[-1]:.3f} s; {frames} frames from {start_s:g} s do "
            "not fit"
        )
    return from_moments(made, crop, source.warnings)


def read_at(
    source: FrameSource,
    times_s: Sequence[float],
    *,
    crop: PictureCrop | None = None,
    frame_rate: float = FRAME_RATE_HZ,
) -> Footage:
    """Read the frames of some times, blended where the camera took none (:func:`resample`).

    Parameters
    ----------
    times_s
        Ascending, seconds. Those after the last frame are left out, so the answer may be shorter.
    crop
        By default the largest square in the middle.
    frame_rate
        Steps a second; a frame that comes within SNAP of a step is taken as it is, with its time.

    Raises
    ------
    FootageEndedError
        When the footage ends before the first time.
    FootageError
        When it cannot be read.
    CropError
        When the crop does not lie inside the picture.
    """
    made = list(resample(source.frames(_checked(times_s[0])), times_s, SNAP / frame_rate))
    if not made:
        raise FootageEndedError(f"{source.name} ends before {times_s[0]:.3f} s")
    return from_moments(made, crop, source.warnings)


def rate_near(source: FrameSource, start_s: float = 0.0) -> float:
    """Return how many frames a second footage has near a time.

    Raises
    ------
    FootageError
        When it cannot be read, or has no two frames there.
    """
    head = list(islice(source.frames(_checked(start_s)), 2 + LOOK_AHEAD))
    if len(head) < 2:
        raise FootageError(f"{source.name} has one frame from {start_s:g} s on")
    return 1 / usual_distance([frame.time_s for frame in head])


def resample(
    taken: Iterable[TakenFrame], wanted_s: Sequence[float], near_s: float
) -> Iterator[TimedFrame]:
    """Yield a picture for each of some ascending times, until the footage ends.

    A picture between two is the two of them, faded into each other: a forecast from pictures made
    so is nearly as good as one from pictures that were taken then, while one that mistakes the
    time between its pictures is far off (decision 0122).

    Parameters
    ----------
    near_s
        A picture that was taken so near to a time is returned as it is, with its own time.
    """
    taken = iter(taken)
    before = next(taken, None)
    after = next(taken, None)
    for time_s in wanted_s:
        while before is not None and after is not None and after.time_s < time_s:
            before, after = after, next(taken, None)
        if before is None or (after is None and time_s > before.time_s + near_s):
            return
        last = after or before
        is_before = abs(before.time_s - time_s) <= abs(last.time_s - time_s)
        nearest = before if is_before else last
        if abs(nearest.time_s - time_s) <= near_s or not before.time_s < time_s < last.time_s:
            yield TimedFrame(nearest.load(), nearest.time_s)
        else:
            yield _blended(before, last, time_s)


def _blended(before: TakenFrame, after: TakenFrame, time_s: float) -> TimedFrame:
    over_s = after.time_s - before.time_s
    share = (time_s - before.time_s) / over_s
    mixed = (1 - share) * before.load().astype(np.float32)
    mixed += share * after.load().astype(np.float32)
    return TimedFrame(mixed.round().astype(np.uint8), time_s, over_s)


def from_moments(
    moments: Sequence[TimedFrame], crop: PictureCrop | None, warnings: Iterable[str] = ()
) -> Footage:
    """Crop every picture to the same part, by default the largest square in the centre."""
    height, width = moments[0].picture.shape[:2]
    crop = crop or SquareCrop.centred(width, height)
    return Footage(
        np.stack([crop.cut(moment.picture) for moment in moments]),
        np.array([moment.time_s for moment in moments], np.float64),
        crop,
        max(moment.blended_over_s for moment in moments),
        tuple(warnings),
    )


def usual_distance(times_s: Sequence[float]) -> float:
    """Return the time between frames where none is missing; containers round it."""
    distances_s = np.diff(times_s)
    return float(distances_s[distances_s < 1.5 * np.median(distances_s)].mean())


def _checked(start_s: float) -> float:
    if not math.isfinite(start_s) or start_s < 0:
        raise FootageError(f"the start is {start_s:g} s, expected 0 or later")
    return start_s


def _spacing(
    times_s: Sequence[float], frame_rate: float, told_rates: tuple[float, float] | None
) -> float:
    """Return the time between the wanted frames: a multiple of the camera's if that will do."""
    if len(times_s) < 2:
        return 1 / frame_rate
    distance_s = usual_distance(times_s)
    spacing_s = max(1, round(1 / (frame_rate * distance_s))) * distance_s
    is_near = abs(spacing_s * frame_rate - 1) <= RATE_TOLERANCE
    is_told = told_rates is not None and is_among(1 / spacing_s, told_rates)
    return spacing_s if is_near or is_told else 1 / frame_rate


def is_among(frame_rate: float, rates: tuple[float, float]) -> bool:
    """Return whether a rate lies between two others, or is as good as one, to RATE_TOLERANCE."""
    lowest, highest = rates
    return lowest * (1 - RATE_TOLERANCE) <= frame_rate <= highest * (1 + RATE_TOLERANCE)
