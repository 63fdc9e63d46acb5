"""Shared options and the outcome of commands."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeAlias

import httpx2
import typer

from rollcast.client import Client
from rollcast.client.settings import DEFAULT_URL, URL_VARIABLE
from rollcast.errors import InvalidArgumentError
from rollcast.footage import SquareCrop
from rollcast.schemas import MAX_RATE_HZ, MIN_RATE_HZ, BallPrompt
from rollcast.trajectory import FRAME_RATE_HZ

PICTURES = (".png", ".jpg", ".jpeg", ".webp")
VIDEOS = (".mp4", ".webm", ".gif")
NUMBER = r"[0-9]{1,9}(\.[0-9]{0,9})?|\.[0-9]{1,9}"

Connect: TypeAlias = Callable[[str | None], Client]
"""Maker of the client of an address, None for the default one."""
Format: TypeAlias = Literal["table", "json", "csv"]


class Outcome(NamedTuple):
    """Output of a command, printed when it succeeds."""

    text: str
    """Text for stdout, without the final newline."""
    warnings: Sequence[str] = ()
    """Text for stderr."""
    code: int = 0
    """Exit code."""
    finish: Callable[[], None] | None = None
    """Work that follows when the text has been printed: pictures and videos."""


class CommandError(Exception):
    """A command cannot do its work; the message is one line for the user."""


def client(context: typer.Context, url: str | None) -> Client:
    """Return a client for an address, created by the runner of the commands.

    Raises
    ------
    CommandError
        If the environment's proxies or certificates cannot be used.
    """
    connect: Connect = context.obj
    try:
        return connect(url)
    except InvalidArgumentError:  # of an argument or a variable, which it names
        raise
    except (ImportError, OSError, ValueError) as error:
        raise CommandError(
            f"no connection can be made ({error}): check the environment's proxies (ALL_PROXY, "
            "HTTP_PROXY, HTTPS_PROXY; NO_PROXY=127.0.0.1 excludes local addresses) and "
            "certificates "
            "(SSL_CERT_FILE, SSL_CERT_DIR)"
        ) from error


def _url(text: str) -> str:
    fault = typer.BadParameter(f"{text} is not an address like {DEFAULT_URL}")
    try:
        url = httpx2.URL(text)
    except httpx2.InvalidURL as error:
        raise fault from error
    if url.scheme not in {"http", "https"} or not url.host:
        raise fault
    return text


def _seconds(text: str) -> float:
    if not re.fullmatch(r"[0-9]+(\.[0-9]*)?|\.[0-9]+", text):
        raise typer.BadParameter(f"{text} is not a number of seconds, 0 or more")
    return float(text)


def positive_rate(text: str) -> float:
    """Parse a number of frames or steps a second."""
    is_number = re.fullmatch(r"[0-9]+(\.[0-9]*)?|\.[0-9]+", text)
    if not is_number or not MIN_RATE_HZ <= float(text) <= MAX_RATE_HZ:
        raise typer.BadParameter(f"{text} is not a rate in Hz, {MIN_RATE_HZ:g} to {MAX_RATE_HZ}")
    return float(text)


def _crop(text: str) -> SquareCrop:
    if not re.fullmatch(r"[0-9]+,[0-9]+,[0-9]+", text):
        raise typer.BadParameter(f"{text} is not X,Y,SIZE, three whole numbers")
    return SquareCrop(*map(int, text.split(",")))


def _ball(text: str) -> BallPrompt:
    numbers = text.split(",")
    if not 2 <= len(numbers) <= 3 or not all(re.fullmatch(NUMBER, number) for number in numbers):
        raise typer.BadParameter(f"{text} is not X,Y or X,Y,RADIUS in pixels")
    x, y, *radius = map(float, numbers)
    if radius == [0]:
        raise typer.BadParameter(f"{text} has the radius 0")
    return BallPrompt(x=x, y=y, radius=radius[0] if radius else None)


def whole_number(lowest: int, highest: int) -> Callable[[str | int], int]:
    """Return a parser of whole numbers within bounds."""

    def parse(given: str | int) -> int:
        text = str(given)  # a default is given as the number it is
        if not re.fullmatch(r"[0-9]{1,16}", text) or not lowest <= int(text) <= highest:
            raise typer.BadParameter(f"{text} is not a whole number from {lowest} to {highest}")
        return int(text)

    return parse


def _drawing(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() not in PICTURES + VIDEOS:
        raise typer.BadParameter(f"{text} is not a {', '.join(PICTURES + VIDEOS)} file")
    return _in_a_folder(path)


def _folder_or_video(text: str) -> Path:
    path = Path(text)
    if path.suffix and path.suffix.lower() not in VIDEOS:
        raise typer.BadParameter(f"{text} is neither a folder nor a {', '.join(VIDEOS)} file")
    return _in_a_folder(path)


def _in_a_folder(path: Path) -> Path:
    if not path.parent.is_dir():
        raise typer.BadParameter(f"the folder {path.parent} does not exist")
    return path


Url: TypeAlias = Annotated[
    str | None,
    typer.Option(
        parser=_url,
        metavar="ADDRESS",
        help=f"address of the service (default: {URL_VARIABLE}, else {DEFAULT_URL})",
        show_default=False,
    ),
]
Start: TypeAlias = Annotated[
    float | None,
    typer.Option(
        parser=_seconds,
        metavar="SECONDS",
        help="time of the first of the four frames in the video (default: 0)",
    ),
]
Stride: TypeAlias = Annotated[
    int | None,
    typer.Option(
        parser=whole_number(1, 1000),
        metavar="N",
        help="use every N-th frame without interpolation (default: "
        f"{FRAME_RATE_HZ} frames per second)",
    ),
]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option(
        parser=positive_rate,
        metavar="HZ",
        help=f"frame rate of the camera in Hz, for images (default: {FRAME_RATE_HZ}), elementary "
        "streams, which do not state it, and slow motion, which is stored at a lower rate",
    ),
]
Crop: TypeAlias = Annotated[
    SquareCrop | None,
    typer.Option(
        parser=_crop,
        metavar="X,Y,SIZE",
        help="square crop given to the model: left column, top row, side, in pixels (default: the "
        "whole picture for a model for any number of balls, otherwise the largest square in the "
        "centre, which the bowl or plane should just fill)",
    ),
]
Balls: TypeAlias = Annotated[
    list[BallPrompt] | None,
    typer.Option(
        "--ball",
        parser=_ball,
        metavar="X,Y[,RADIUS]",
        help="selects a ball by a point in the last of the four frames, in pixels of the uncropped "
        "picture; repeat for several balls, in the order of the answer",
        show_default=False,
    ),
]
Drawing: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        parser=_drawing,
        metavar="FILE",
        help="draw the forecast over the footage: a picture (.png, .jpg, .webp) or a video "
        "(.mp4, .webm, .gif)",
    ),
]
FolderOrVideo: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        parser=_folder_or_video,
        metavar="FOLDER|FILE",
        help="an empty or new folder for the frames, the true path and the scene; or a video of "
        "the frames (.mp4, .webm, .gif)",
    ),
]
Slowdown: TypeAlias = Annotated[
    int,
    typer.Option(
        parser=whole_number(1, 100),
        metavar="N",
        help="play the video N times slower than real time",
    ),
]
Printed: TypeAlias = Annotated[Format, typer.Option("--format", help="output format")]
