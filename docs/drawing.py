"""What the pictures are drawn with: their colours, frames, ellipses, boxes and arrows."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, FancyArrowPatch, FancyBboxPatch
from PIL import Image

from rollcast.plot import PALETTE, SIGMAS

ORANGE, BLUE, PURPLE, YELLOW, GREEN = PALETTE
INK, GREY, PALE, GROUND = "#222222", "#777777", "#dddddd", "#e8e2d6"
STYLE: dict[Any, Any] = {
    "savefig.dpi": 100,
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "axes.labelcolor": INK,
}


def write(picture: Figure | Image.Image, path: Path) -> None:
    """Write a picture as small as it gets without loss."""
    if isinstance(picture, Image.Image):
        picture.save(path, optimize=True)
        return
    buffer = io.BytesIO()
    picture.savefig(buffer, format="png", metadata={"Software": None})
    with Image.open(buffer) as drawn:
        drawn.convert("RGB").save(path, optimize=True)


def show(axes: Axes, frame: np.ndarray) -> None:
    """Show a frame, its pixels counted from its top-left corner."""
    size = len(frame)
    axes.imshow(frame, extent=(0, size, size, 0), interpolation="bicubic")
    axes.set(xlim=(0, size), ylim=(size, 0), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)


def ellipse(centre: np.ndarray, covariance: np.ndarray, color: str) -> Ellipse:
    """Return the ellipse of SIGMAS standard deviations of a Gaussian."""
    variances, axes = np.linalg.eigh(covariance)
    width, height = 2 * SIGMAS * np.sqrt(variances)
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    return Ellipse(
        (float(centre[0]), float(centre[1])), float(width), float(height), angle=angle,
        facecolor=f"{color}40", edgecolor=color, linewidth=1,
    )  # fmt: skip


def box(
    axes: Axes, x: float, y: float, width: float, height: float, text: str, color: str,
    size: float = 10.5,
) -> None:  # fmt: skip
    """Draw a rounded box with a text in it."""
    axes.add_patch(
        FancyBboxPatch(
            (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.18",
            facecolor=f"{color}33", edgecolor=color, linewidth=1.6,
        )
    )  # fmt: skip
    axes.text(x + width / 2, y + height / 2, text, ha="center", va="center", size=size)


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw an arrow."""
    axes.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=12, color=INK, linewidth=1.2,
            shrinkA=1, shrinkB=1,
        )
    )  # fmt: skip
