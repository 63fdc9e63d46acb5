"""Measures how well a model finds balls in real clips whose balls have been tracked by hand.

    python -m training real-clips models/any-ball/1 CLIPS TRACKS

Such clips are for evaluation: nothing trains on them. CLIPS is a folder of videos. TRACKS has a
``setup.json`` with a crop, the balls that are meant and the frames to use of every clip, and a
table ``NAME.csv`` of each: clip, frame, time, ball, x, y, radius, in pixels of the video.
"""

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from rollcast.ball_finding import Detect, Refine, find_balls, moving_balls
from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.markdown import header, row
from rollcast.scene import MAX_BALLS
from rollcast.trajectory import OBSERVED_FRAMES
from rollcast.video import every_frame
from training.networks.blocks import PIXEL_UNIT
from training.networks.perception import Perception
from training.networks.recurrent import Network, PerceptionOutput

EVERY = 2
"""Frames between the beginnings of windows."""

MOVES_PX = 0.5
"""Least way of the ball over a window that counts."""

MOST_WINDOWS = 80
"""Number of windows of a clip, spread evenly."""

FOUND_PX = 2.0
"""A ball is found within its radius, or within this where the radius is smaller."""

PROMPT_ERROR_PX = 1.5
"""Standard deviation of a prompt along each axis."""


class ClipWindow(NamedTuple):
    """Four frames of a clip with the places of one ball in them, pixels of 128."""

    frames: UInt8[np.ndarray, "4 128 128 3"]
    path: Float[np.ndarray, "4 2"]
    radius: float


class Found(NamedTuple):
    """Detections of a model in the windows of a clip, pixels of 128."""

    position_errors: Float[np.ndarray, " windows"]
    """Position errors at t = 0."""
    displacement_errors: Float[np.ndarray, " windows"]
    """Errors of the last displacement."""
    found: Bool[np.ndarray, " windows"]


def clip_windows(
    clips: Path, tracks: Path, name: str, setup: Mapping[str, Any]
) -> list[ClipWindow]:
    """Cut a clip's windows out of its video."""
    kept = _kept_frames(tracks, setup)
    paths, radii = _paths(tracks / f"{setup.get('tracks', name)}.csv", setup["crop"], kept)
    places: list[tuple[int, str]] = []
    for first, last in setup.get("ranges") or [[0, max(map(max, paths.values()))]]:
        for start in range(first, last - OBSERVED_FRAMES + 2, EVERY):
            places += [(start, ball) for ball in setup["targets"] if _moves(paths[ball], start)]
    if len(places) > MOST_WINDOWS:
        chosen = np.linspace(0, len(places) - 1, MOST_WINDOWS).astype(int)
        places = [places[k] for k in chosen]
    wanted = {start + k for start, _ in places for k in range(OBSERVED_FRAMES)}
    pictures = dict(_pictures(clips / setup["file"], setup["crop"], kept, wanted))
    return [
        ClipWindow(
            np.stack([pictures[start + k] for k in range(OBSERVED_FRAMES)]),
            np.array([paths[ball][start + k] for k in range(OBSERVED_FRAMES)]),
            radii[ball],
        )
        for start, ball in places
    ]


def _kept_frames(tracks: Path, setup: Mapping[str, Any]) -> dict[int, int] | None:
    """Return the new number of every frame of the video that is no repeat; None for all of them."""
    if not setup.get("keep"):
        return None
    frames = json.loads((tracks / setup["keep"]).read_text(encoding="utf-8"))
    return {frame: number for number, frame in enumerate(frames)}


def _paths(
    table: Path, crop: tuple[int, int, int], kept: dict[int, int] | None
) -> tuple[dict[str, dict[int, tuple[float, float]]], dict[str, float]]:
    """Places of every ball by frame, and its median radius, pixels of 128."""
    left, top, side = crop
    scale = NETWORK_FRAME_SIZE / side
    paths: dict[str, dict[int, tuple[float, float]]] = {}
    radii: dict[str, list[float]] = {}
    for ball, frame, place_x, place_y, radius in _hand_rows(table):
        if kept is not None and frame not in kept:
            continue
        x, y = place_x - left, place_y - top
        if 0 <= x <= side and 0 <= y <= side:
            number = frame if kept is None else kept[frame]
            paths.setdefault(ball, {})[number] = (scale * x, scale * y)
        radii.setdefault(ball, []).append(scale * radius)
    return paths, _medians(radii)


def hand_tracks(
    table: Path,
) -> tuple[dict[str, dict[int, tuple[float, float]]], dict[str, float]]:
    """Places of every ball by frame, and its median radius, pixels of the video."""
    paths: dict[str, dict[int, tuple[float, float]]] = {}
    radii: dict[str, list[float]] = {}
    for ball, frame, x, y, radius in _hand_rows(table):
        paths.setdefault(ball, {})[frame] = (x, y)
        radii.setdefault(ball, []).append(radius)
    return paths, _medians(radii)


def _hand_rows(table: Path) -> Iterator[tuple[str, int, float, float, float]]:
    """Yield ball, frame, x, y and radius of every ball that is seen in a frame."""
    with table.open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            if line["x"] not in ("", "nan", "null"):
                radius = float(line["radius"] or "nan")
                yield line["ball"], int(line["frame"]), float(line["x"]), float(line["y"]), radius


def _medians(radii: Mapping[str, Sequence[float]]) -> dict[str, float]:
    return {ball: float(np.nanmedian(values)) for ball, values in radii.items()}


def _moves(path: Mapping[int, tuple[float, float]], start: int) -> bool:
    frames = range(start, start + OBSERVED_FRAMES)
    if any(frame not in path for frame in frames):
        return False
    return float(np.hypot(*np.subtract(path[frames[-1]], path[start]))) >= MOVES_PX


def _pictures(
    video: Path, crop: tuple[int, int, int], kept: dict[int, int] | None, wanted: set[int]
) -> Iterator[tuple[int, UInt8[np.ndarray, "128 128 3"]]]:
    left, top, side = crop
    for frame, moment in enumerate(every_frame(video)):
        number = frame if kept is None else kept.get(frame, -1)
        if number in wanted:
            cut = np.ascontiguousarray(moment.picture[top : top + side, left : left + side])
            size = (NETWORK_FRAME_SIZE,) * 2
            yield number, cv2.resize(cut, size, interpolation=cv2.INTER_AREA)


BallFinder = Callable[[UInt8[np.ndarray, "4 128 128 3"], Float[np.ndarray, "2"] | None], np.ndarray]
"""Frames, and perhaps a prompt in halves of the frame, to the paths [balls, 4, 2] of the balls that
a model answers with, in halves of the frame."""


def perception_finder(network: Network) -> BallFinder:
    """Return how a network for a fixed number of balls sees: its first ball."""
    (perception,) = (part for part in network.modules() if isinstance(part, Perception))

    def finder(frames: np.ndarray, prompt: np.ndarray | None) -> np.ndarray:
        prompts = None if prompt is None else torch.from_numpy(prompt[None, None]).float()
        with torch.inference_mode():
            perceived: PerceptionOutput = perception(torch.from_numpy(frames[None]), prompts)
        return perceived.seen_positions[-1][0, :1].numpy()

    return finder


def any_ball_finder(detect: Detect, refine: Refine) -> BallFinder:
    """Return how a network for any number of balls sees: the prompted ball, or all that move."""

    def finder(frames: np.ndarray, prompt: np.ndarray | None) -> np.ndarray:
        balls, _ = find_balls(detect, refine, frames, None if prompt is None else prompt[None])
        return balls.places if prompt is not None else balls.places[moving_balls(balls, MAX_BALLS)]

    return finder


def find(finder: BallFinder, windows: list[ClipWindow], *, prompted: bool) -> Found:
    """Measure a model on windows.

    Of several balls that it answers with, the one nearest to the true place counts.

    Parameters
    ----------
    prompted
        Whether it is told roughly where the ball is in the last frame.
    """
    errors = np.random.default_rng(0).normal(0, PROMPT_ERROR_PX, (len(windows), 2))
    offs: list[np.ndarray] = []
    for window, error in zip(windows, errors, strict=True):
        rough = (window.path[-1] + error - PIXEL_UNIT) / PIXEL_UNIT
        seen = PIXEL_UNIT + PIXEL_UNIT * finder(window.frames, rough if prompted else None)
        off = seen - window.path
        offs.append(off[np.linalg.norm(off[:, -1], axis=-1).argmin()])
    off = np.stack(offs)
    away = np.linalg.norm(off[:, -1], axis=-1)
    radii = np.array([window.radius for window in windows])
    return Found(
        away, np.linalg.norm(off[:, -1] - off[:, -2], axis=-1), away <= np.maximum(radii, FOUND_PX)
    )


def table(finder: BallFinder, clips: Path, tracks: Path) -> Iterator[str]:
    """Lines of a table, one for every clip."""
    setups = json.loads((tracks / "setup.json").read_text(encoding="utf-8"))
    yield header(
        ["clip", "windows", "found, %", "displacement, px: median / mean", "with a prompt", ""]
    )
    measured: list[tuple[Found, Found]] = []
    for name, setup in setups.items():
        windows = clip_windows(clips, tracks, name, setup)
        alone, prompted = (find(finder, windows, prompted=p) for p in (False, True))
        measured.append((alone, prompted))
        yield row([name, len(windows), *_cells(alone), *_cells(prompted)])
    ways = list(zip(*measured, strict=True))
    shares = [100 * np.mean([one.found.mean() for one in way]) for way in ways]
    yield row(["mean of clips", "", f"{shares[0]:.0f}", "", f"{shares[1]:.0f}", ""])
    whole = [_together(way) for way in ways]
    yield row(["all windows", len(whole[0].found), *_cells(whole[0]), *_cells(whole[1])])


def _together(parts: Sequence[Found]) -> Found:
    return Found(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _cells(found: Found) -> tuple[str, str]:
    errors = found.displacement_errors
    share = 100 * found.found.mean()
    return f"{share:.0f}", f"{np.median(errors):.2f} / {errors.mean():.2f}"
