"""Tracks drawn over their footage."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from rollcast.clip import open_clip
from rollcast.footage import FrameSource
from rollcast.plot import PALETTE
from rollcast.tracking.tracks import Tracks

TAIL = 15
"""Frames of a ball's way behind it."""


def overlaid(clip: Path | FrameSource, tracks: Tracks) -> Iterator[Image.Image]:
    """Yield every tracked picture of a clip with its balls' numbers, outlines and ways.

    A ball that is not found is named in the corner, and drawn nowhere.
    """
    source = open_clip(clip) if isinstance(clip, Path) else clip
    place = {number: index for index, number in enumerate(tracks.frames.tolist())}
    for number, taken in enumerate(source.frames()):
        if number in place:
            yield draw_tracks(taken.load(), tracks, place[number])


def draw_tracks(picture: np.ndarray, tracks: Tracks, index: int) -> Image.Image:
    """Draw the balls of a frame over its picture, whose sides are made even for videos."""
    height, width = picture.shape[:2]
    image = Image.fromarray(np.ascontiguousarray(picture[: height // 2 * 2, : width // 2 * 2]))
    drawing = ImageDraw.Draw(image)
    missing: list[str] = []
    for ball in range(tracks.balls):
        color = PALETTE[ball % len(PALETTE)]
        x, y = tracks.positions_px[index, ball]
        if np.isnan(x):
            missing.append(str(ball))
            continue
        radius = tracks.radii_px[index, ball] + 1
        drawing.ellipse((x - radius, y - radius, x + radius, y + radius), outline=color, width=2)
        drawing.text(
            (x + radius, y - radius), str(ball), fill=color, stroke_width=2, stroke_fill="black"
        )
        tail = tracks.positions_px[max(0, index - TAIL) : index + 1, ball]
        drawing.line([tuple(place) for place in tail[~np.isnan(tail[:, 0])]], color, 1)
    note = f"frame {tracks.frames[index]}" + (
        f", not found: {', '.join(missing)}" if missing else ""
    )
    drawing.text((4, 4), note, fill="white", stroke_width=2, stroke_fill="black")
    return image
