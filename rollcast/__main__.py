"""``python -m rollcast``: the service from a shell.

Exit codes: 0 done, 1 it failed (one line on stderr says why), 2 the arguments are wrong.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import httpx2
import numpy as np
from PIL import Image

from rollcast.client import Client, Forecast
from rollcast.errors import RollcastError, UnreachableError
from rollcast.footage import Footage, SquareCrop, read_images
from rollcast.http import AUTO_MODEL, DEFAULT_HORIZON, MAX_HORIZON
from rollcast.plot import draw_forecast
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES

IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})
LATER_FRAMES = 6
"""In the picture, where the footage goes on after the observed frames."""
TABLE_ROWS = 10
UNEVEN = 0.25
"""Share by which a frame may come early or late without a warning."""

LaterFrames = Callable[[Sequence[float]], Footage]
"""Reads the frames nearest to some times of the footage, seconds."""


class _Failure(Exception):
    """One line for the user."""


def main(arguments: Sequence[str] | None = None, connect: Callable[[str], Client] = Client) -> int:
    """Run one command and return the exit code.

    Parameters
    ----------
    arguments
        By default those of the process.
    connect
        Makes the client of an address.
    """
    options = _parser().parse_args(arguments)
    try:
        _predict(options, connect)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader, `head` for example, has seen enough; Python would complain of it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except UnreachableError as error:
        print(f"rollcast: {error}; is the service running (make serve)?", file=sys.stderr)
    except (RollcastError, _Failure, OSError) as error:
        print(f"rollcast: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("rollcast: interrupted", file=sys.stderr)
    else:
        return 0
    return 1


def _predict(options: argparse.Namespace, connect: Callable[[str], Client]) -> None:
    """Read frames, ask the service where the ball goes, show what it says."""
    observed, later_frames = _read(options.input, options.start, options.crop)
    with connect(options.url) as client:
        forecast = client.predict(
            list(observed.frames),
            horizon=options.horizon,
            model=options.model,
            frame_rate=observed.frame_rate,
        )
    if options.out is not None:
        _draw(observed, later_frames, forecast).save(options.out)
    _print_forecast(observed, forecast)


def _read(
    paths: list[Path], start_s: float | None, crop: SquareCrop | None
) -> tuple[Footage, LaterFrames]:
    """Return the observed frames and what reads later ones."""
    if len(paths) == 1 and not paths[0].is_dir():
        return _read_video(paths[0], start_s or 0.0, crop)
    if start_s is not None:
        raise _Failure("--start is for a video; of images the first four are observed")
    return _read_images(_images_in(paths[0]) if len(paths) == 1 else paths, crop)


def _read_video(path: Path, start_s: float, crop: SquareCrop | None) -> tuple[Footage, LaterFrames]:
    try:
        from rollcast.video import frames_at, read_frames
    except ModuleNotFoundError as error:
        raise _Failure("videos need PyAV: pip install 'rollcast[video]'") from error
    observed = read_frames(path, start_s=start_s, crop=crop)
    return observed, lambda times_s: frames_at(path, times_s, crop=crop)


def _read_images(paths: list[Path], crop: SquareCrop | None) -> tuple[Footage, LaterFrames]:
    if len(paths) < OBSERVED_FRAMES:
        raise _Failure(f"{len(paths)} images, expected a video, a folder or at least four images")
    footage = read_images(paths, crop=crop)

    def later_frames(times_s: Sequence[float]) -> Footage:
        indices = [round(time_s * FRAME_RATE_HZ) for time_s in times_s]
        return footage.part([index for index in indices if index < len(paths)])

    return footage.part(slice(OBSERVED_FRAMES)), later_frames


def _images_in(folder: Path) -> list[Path]:
    """Return the images of a folder; frame10 comes after frame9."""
    images = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    return sorted(
        images,
        key=lambda path: [
            (int(part), "") if part.isdigit() else (-1, part)
            for part in re.split(r"([0-9]+)", path.name)
        ],
    )


def _print_forecast(observed: Footage, forecast: Forecast) -> None:
    crop = observed.crop
    print(
        f"{forecast.model.name}@{forecast.model.version}: four frames from "
        f"{observed.times_s[0]:.3f} s to {observed.times_s[-1]:.3f} s "
        f"({observed.frame_rate:.3g} a second), crop {crop.x},{crop.y},{crop.size}"
    )
    print("time_s: seconds after the last of them; x, y: pixels of the uncropped picture")
    print(f"{'time_s':>7} {'ball':>4} {'x':>8} {'y':>8}")
    for step in _spread(len(forecast.times_s), TABLE_ROWS):
        for ball, (x, y) in enumerate(forecast.positions[:, step] + (crop.x, crop.y)):
            print(f"{forecast.times_s[step]:7.3f} {ball:4} {x:8.1f} {y:8.1f}")
    if observed.unevenness > UNEVEN:
        print("warning: the four frames are not evenly spaced; the footage lacks some there")
    for warning in forecast.warnings:
        print(f"warning: {warning}")


def _draw(observed: Footage, later_frames: LaterFrames, forecast: Forecast) -> Image.Image:
    now_s = observed.times_s[-1]
    wanted_s = now_s + forecast.times_s[_spread(len(forecast.times_s), LATER_FRAMES + 1)]
    shown = later_frames(wanted_s.tolist())
    return draw_forecast(shown.frames, shown.times_s - now_s, forecast)


def _spread(steps: int, count: int) -> list[int]:
    """Return at most ``count`` steps from the first to the last, evenly spread."""
    return sorted({round(step) for step in np.linspace(0, steps - 1, min(steps, count)).tolist()})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m rollcast", description="Forecasts where rolling balls go."
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    predict = commands.add_parser(
        "predict",
        help="forecast the ball of a video or of images",
        description="Read four frames, ask a running service where the ball goes, print the path "
        "and, with --out, draw it over the footage.",
    )
    predict.add_argument(
        "input",
        nargs="+",
        type=Path,
        metavar="VIDEO|FOLDER|IMAGE",
        help="a video, of which four frames as near as possible to 40 a second are read; or a "
        "folder of images, or at least four images, 40 a second",
    )
    predict.add_argument(
        "--start",
        type=_start,
        metavar="SECONDS",
        help="time of the first of the four frames in the video (default: 0)",
    )
    predict.add_argument(
        "--crop",
        type=_crop,
        metavar="X,Y,SIZE",
        help="the square that is looked at: left column, upper row, side, in pixels (default: the "
        "largest in the middle); models know frames that the bowl or plane just fills",
    )
    predict.add_argument(
        "--horizon",
        type=_horizon,
        default=DEFAULT_HORIZON,
        metavar="STEPS",
        help=f"steps to forecast, as far apart as the frames (default: {DEFAULT_HORIZON})",
    )
    predict.add_argument(
        "--model", default=AUTO_MODEL, help="auto, NAME or NAME@VERSION (default: auto)"
    )
    predict.add_argument(
        "--url",
        type=_url,
        default="http://127.0.0.1:8000",
        help="address of the service (default: http://127.0.0.1:8000)",
    )
    predict.add_argument(
        "--out", type=_picture, metavar="FILE", help="picture to draw: .png, .jpg or .webp"
    )
    return parser


def _start(text: str) -> float:
    if not re.fullmatch(r"[0-9]+(\.[0-9]*)?|\.[0-9]+", text):
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds, 0 or more")
    return float(text)


def _crop(text: str) -> SquareCrop:
    if not re.fullmatch(r"[0-9]+,[0-9]+,[0-9]+", text):
        raise argparse.ArgumentTypeError(f"{text} is not X,Y,SIZE, three whole numbers")
    return SquareCrop(*map(int, text.split(",")))


def _horizon(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,4}", text) or not 1 <= int(text) <= MAX_HORIZON:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1 to {MAX_HORIZON}")
    return int(text)


def _url(text: str) -> str:
    fault = argparse.ArgumentTypeError(f"{text} is not an address like http://127.0.0.1:8000")
    try:
        url = httpx2.URL(text)
    except httpx2.InvalidURL as error:
        raise fault from error
    if url.scheme not in {"http", "https"} or not url.host:
        raise fault
    return text


def _picture(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() not in {".png", ".jpg", ".jpeg", ".webp"}:
        raise argparse.ArgumentTypeError(f"{text} is not a .png, .jpg or .webp file")
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"the folder {path.parent} does not exist")
    return path


if __name__ == "__main__":
    sys.exit(main())
