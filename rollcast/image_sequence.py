"""Image files, or the pages of a TIFF file, as footage.

The order is that of the numbers in the names, frame10 after frame9, for every reader. Where the
numbers of files that differ in one number alone leave gaps, the gaps are time: no camera skips a
number for nothing.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from rollcast.errors import FootageError, FrameError
from rollcast.footage import TakenFrame
from rollcast.frames import (
    DECODER_ERRORS,
    as_frame,
    decoded_page,
    is_heic,
    is_image_name,
    open_image,
    require_regular_file,
    shown_path,
)

TIFF_HEADS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
MAX_NAME = 255
"""Characters of the longest file name that is looked at."""
GAPS_NAMED = 3
"""Gaps that a warning names; of more it gives the number."""


class _Page(NamedTuple):
    """One picture: a file, or a page of one."""

    path: Path
    page: int | None = None

    def __str__(self) -> str:
        place = "" if self.page is None else f", page {self.page + 1}"
        return f"{shown_path(self.path)}{place}"

    def load(self) -> UInt8[np.ndarray, "height width 3"]:
        """Read it; raises FrameError or OSError."""
        if self.page is None:
            return as_frame(self.path)
        try:
            with open_image(self.path) as image:
                image.seek(self.page)
                return decoded_page(image, str(self))
        except FrameError:
            raise
        except DECODER_ERRORS as error:
            raise FrameError(f"{self} is damaged: {error}") from error


class ImageSequence:
    """Images as a source of frames (``rollcast.footage.FrameSource``); each is read when needed.

    Parameters
    ----------
    name
        Name for messages.
    rate
        Images a second.
    numbers
        Number of each image in the sequence, ascending.
    warnings
        Sentences about the sequence.
    """

    def __init__(
        self,
        name: str,
        pages: Sequence[_Page],
        rate: float,
        numbers: Sequence[int] | None = None,
        warnings: Sequence[str] = (),
    ) -> None:
        self.name = name
        self.warnings = list(warnings)
        self._pages = list(pages)
        self._size: tuple[int, int] | None = None
        self.rate = rate
        self.numbers = list(range(len(pages))) if numbers is None else list(numbers)

    @classmethod
    def from_files(cls, paths: Sequence[Path], rate: float, name: str) -> "ImageSequence":
        """Return image files in the given order; numbers in their names determine gaps."""
        numbers, warnings = _numbering(paths, "the gap counts as time")
        return cls(name, [_Page(path) for path in paths], rate, numbers, warnings)

    @classmethod
    def from_folder(cls, folder: Path, rate: float) -> "ImageSequence":
        """Return the images of a folder in the order of their numbers.

        Raises
        ------
        FootageError
            When the folder cannot be read.
        """
        return cls.from_files(image_files(folder), rate, shown_path(folder))

    @classmethod
    def from_stack(cls, path: Path, rate: float) -> "ImageSequence":
        """Return the pages of a TIFF file.

        Raises
        ------
        FootageError
            When it cannot be read.
        """
        try:
            with open_image(path) as image:
                pages = int(getattr(image, "n_frames", 1))
        except DECODER_ERRORS as error:
            raise FootageError(f"{shown_path(path)} cannot be read: {error}") from error
        return cls(shown_path(path), [_Page(path, index) for index in range(pages)], rate)

    def __len__(self) -> int:
        """Return how many images there are."""
        return len(self._pages)

    def frames(self, start_s: float = 0.0) -> Iterator[TakenFrame]:
        """Yield the images from the last one at or before a time on."""
        times_s = [(number - self.numbers[0]) / self.rate for number in self.numbers]
        before = [index for index, time_s in enumerate(times_s) if time_s <= start_s]
        first = before[-1] if before else 0
        for time_s, page in zip(times_s[first:], self._pages[first:], strict=True):
            yield TakenFrame(time_s, partial(self._load, page))

    def _load(self, page: _Page) -> UInt8[np.ndarray, "height width 3"]:
        try:
            picture = page.load()
        except FrameError:
            raise
        except OSError as error:
            raise FootageError(f"{page} cannot be read: {error.strerror or error}") from error
        height, width = picture.shape[:2]
        if self._size not in (None, (width, height)):
            raise FootageError(
                f"{page} is {width} x {height}, the first image {self._size[0]} x {self._size[1]}"
            )
        self._size = (width, height)
        return picture


def image_files(folder: Path) -> list[Path]:
    """Return the images of a folder in the order of the numbers in their names.

    Hidden files (``.DS_Store``, ``._frame1.png``) and files that are no images are passed over.

    Raises
    ------
    FootageError
        When the folder cannot be read.
    """
    try:
        files = [path for path in folder.iterdir() if not is_hidden(path) and path.is_file()]
    except OSError as error:
        raise FootageError(f"{shown_path(folder)} cannot be read: {error.strerror}") from error
    return in_order(path for path in files if _is_image(path))


def in_order(paths: Iterator[Path] | Sequence[Path]) -> list[Path]:
    """Sort paths by name, with the numbers in the names as numbers: frame10 after frame9."""
    return sorted(paths, key=lambda path: (_parts(path.name), path.name))


def is_hidden(path: Path) -> bool:
    """Return whether file managers hide a file, such as ``.DS_Store`` and ``._name``."""
    return path.name.startswith(".")


def is_tiff(path: Path) -> bool:
    """Return whether a file begins like a TIFF file.

    Raises
    ------
    FootageError
        When it is a pipe or cannot be read.
    """
    return _head(path)[:4] in TIFF_HEADS


def is_single_picture(path: Path) -> bool:
    """Return whether a file is one picture, by its name and its content.

    A camera's stream of JPEG files begins like one, and animations are videos.
    """
    if is_heic(_head(path)):
        return True
    if not is_image_name(path.name):
        return False
    try:
        with open_image(path) as image:
            return image.format == "MPO" or getattr(image, "n_frames", 1) == 1
    except DECODER_ERRORS:
        return False


def _head(path: Path) -> bytes:
    try:
        require_regular_file(path)
        with path.open("rb") as file:
            return file.read(12)
    except OSError as error:
        raise FootageError(f"{shown_path(path)} cannot be read: {error.strerror}") from error


def _is_image(path: Path) -> bool:
    """Return whether a file is an image by its name or its content."""
    if is_image_name(path.name):
        return True
    try:
        open_image(path).close()
    except DECODER_ERRORS:
        return is_heic(_head(path))
    return True


def _parts(name: str) -> list[str | int]:
    """Text and numbers in turn; only ASCII digits are numbers (``int`` refuses others)."""
    return [
        int(part) if index % 2 else part for index, part in enumerate(re.split("([0-9]+)", name))
    ]


def numbering_warnings(names: Sequence[str]) -> list[str]:
    """Return warnings of file names that contradict frames in order and evenly spaced.

    Parameters
    ----------
    names
        Names or paths of the files; of very long ones nothing is said.
    """
    if any(len(name) > MAX_NAME for name in names):
        return []
    return _numbering([Path(name) for name in names], "the frames are taken as evenly spaced")[1]


def _numbering(paths: Sequence[Path], gap: str) -> tuple[list[int] | None, list[str]]:
    """Return the index of each image in time, and warnings.

    Images whose names do not fit those of the majority take a place of their own.

    Parameters
    ----------
    gap
        Treatment of gaps in the numbering, for the warning.
    """
    within, columns = _counters(paths)
    if not columns:
        return None, []
    warnings: list[str] = []
    if len(within) < len(paths):
        outside = [path for index, path in enumerate(paths) if index not in within]
        warnings.append(
            f"{_named(outside)} {'does' if len(outside) == 1 else 'do'} not fit the numbering of "
            "the other images, but count as frames: leave out what is none"
        )
    ascending = [column for column in columns if min(_steps(column)) > 0]
    if not ascending:
        if len(columns) == 1:
            warnings.append(
                "the images are used in the order of the arguments, which is not the order of "
                "their numbers; images of a folder are sorted by number"
            )
        return None, warnings
    regular = [(step, column) for column in ascending if (step := _step(column)) is not None]
    if not regular:
        steps = _steps(ascending[-1])
        if 10 * max(steps) > 11 * min(steps):  # whole numbers of any size
            warnings.append(
                f"the numbers of the images are {min(steps)} to {max(steps)} apart: "
                "the frames are taken as evenly spaced, in which some may be missing"
            )
        return None, warnings
    step, counted = min(regular, key=lambda found: found[0])
    numbers = [(number - counted[0]) // step for number in counted]
    gaps = [index for index, apart in enumerate(_steps(counted)) if apart > step]
    if gaps:
        warnings.append(f"{_gaps([paths[index] for index in within], numbers, gaps)}: {gap}")
    elif len(within) == len(paths):
        return None, warnings
    return _with_others(numbers, within, len(paths)), warnings


def _counters(paths: Sequence[Path]) -> tuple[list[int], list[list[int]]]:
    """Return the indices of the names that differ in numbers alone, and these numbers.

    They are more than half of the names; each list holds the numbers of one place in them.
    """
    if len(paths) < 2:
        return [], []
    names = [_parts(path.stem) for path in paths]
    text, often = Counter(tuple(parts[::2]) for parts in names).most_common(1)[0]
    if often < 2 or 2 * often <= len(names):
        return [], []
    within = [index for index, parts in enumerate(names) if tuple(parts[::2]) == text]
    columns = zip(*([int(part) for part in names[index][1::2]] for index in within), strict=True)
    return within, [list(column) for column in columns if len({*column}) > 1]


def _steps(numbers: Sequence[int]) -> list[int]:
    return [after - before for before, after in pairwise(numbers)]


def _step(numbers: Sequence[int]) -> int | None:
    """Return the step of numbers that count images; None where they may be times."""
    steps = _steps(numbers)
    step, often = Counter(steps).most_common(1)[0]
    is_regular = step == min(steps) and 2 * often > len(steps) and not any(s % step for s in steps)
    return step if is_regular else None


def _with_others(numbers: Sequence[int], within: Sequence[int], count: int) -> list[int]:
    """Insert a place for each image outside the numbering, in a gap if it is at one."""
    places = dict(zip(within, numbers, strict=True))
    every: list[int] = []
    moved = 0
    for index in range(count):
        following = every[-1] + 1 if every else 0
        place = places[index] + moved if index in places else following
        every.append(max(place, following))
        if index in places:
            moved += every[-1] - place
    return every


def _named(paths: Sequence[Path]) -> str:
    names = ", ".join(shown_path(path.name) for path in paths[:GAPS_NAMED])
    more = len(paths) - GAPS_NAMED
    return f"{names} and {more} more" if more > 0 else names


def _gaps(paths: Sequence[Path], numbers: Sequence[int], gaps: Sequence[int]) -> str:
    missing = sum(numbers[index + 1] - numbers[index] - 1 for index in gaps)
    places = ", ".join(shown_path(paths[index].name) for index in gaps[:GAPS_NAMED])
    more = "" if len(gaps) <= GAPS_NAMED else f" and {len(gaps) - GAPS_NAMED} more"
    images = "image is" if missing == 1 else "images are"
    return f"{missing} {images} missing from the numbering, after {places}{more}"
