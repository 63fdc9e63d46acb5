"""Painting of clutter: rectangles, pockets, texts, hands, cues, shadows."""

import math

import cv2
import numpy as np
from jaxtyping import Float

from rollcast.simulation.appearance import Clutter
from training.data.painting.ground import SIZE, draw_text

BLENDED = 0.5
"""Darkness of shadows of objects outside the frame."""


def clutter_mask(thing: Clutter, frame: int) -> Float[np.ndarray, "size size"]:
    """Share of every pixel that a thing covers in one of the seen frames (0 is the first)."""
    x, y = np.asarray(thing.at) + (frame - 3) * np.asarray(thing.velocity)
    generator = np.random.default_rng(thing.seed)
    mask = np.zeros((SIZE, SIZE), np.uint8)
    cos, sin = math.cos(thing.angle_rad), math.sin(thing.angle_rad)
    match thing.kind:
        case "rectangle" | "shadow":
            half = thing.size * generator.uniform(0.15, 1, 2)
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            turned = corners @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
            _fill(mask, turned)
        case "pocket":
            centre = (round(16 * x), round(16 * y))
            cv2.circle(mask, centre, round(16 * min(thing.size, 12)), 255, -1, cv2.LINE_AA, 4)
        case "text":
            written = np.zeros((SIZE, SIZE, 3), np.uint8)
            draw_text(written, generator, np.array([int(x), int(y)]), np.ones(3))
            mask = np.ascontiguousarray(written[..., 0])
        case "cue":
            tip, end = np.array([x, y]), np.array([x, y]) + 300 * np.array([cos, sin])
            aside = np.array([-sin, cos]) * max(thing.size / 20, 0.6)
            _fill(mask, np.stack([tip - aside, tip + aside, end + 2 * aside, end - 2 * aside]))
        case "hand":
            _hand(mask, np.array([x, y]), np.array([cos, sin]), thing.size, generator)
    soft = mask.astype(np.float32) / 255
    if thing.kind == "shadow":
        return cv2.GaussianBlur(soft, (0, 0), max(thing.size / 8, 0.8))
    return soft


def paint_clutter(
    image: Float[np.ndarray, "size size 3"],
    thing: Clutter,
    mask: Float[np.ndarray, "size size"],
) -> None:
    """Paint a thing into an image 0..1 through its mask, in place."""
    share = mask[..., None]
    if thing.kind == "shadow":
        image *= 1 - BLENDED * share
        return
    image += share * (np.asarray(thing.color, np.float32) - image)


def _hand(
    mask: np.ndarray,
    tip: np.ndarray,
    inwards: np.ndarray,
    size: float,
    generator: np.random.Generator,
) -> None:
    """Draw an arm from beyond the border, a palm and some fingers around the tip."""
    palm = tip + inwards * size
    width = max(size * generator.uniform(0.5, 1.0), 2)
    aside = np.array([-inwards[1], inwards[0]])
    end = palm + 300 * inwards
    _fill(mask, np.stack([palm - aside * width / 2, palm + aside * width / 2,
                          end + aside * width, end - aside * width]))  # fmt: skip
    cv2.circle(mask, _fixed(palm), round(8 * width * 1.3), 255, -1, cv2.LINE_AA, 4)
    for spread in np.linspace(-0.8, 0.8, generator.integers(1, 6)):
        length = size * generator.uniform(0.6, 1.1)
        finger = palm - length * (inwards * math.cos(spread) - aside * math.sin(spread))
        thickness = max(round(size / 5), 1)
        cv2.line(mask, _fixed(palm), _fixed(finger), 255, thickness, cv2.LINE_AA, 4)


def _fixed(point: np.ndarray) -> tuple[int, int]:
    """Coordinates with four binary places, as OpenCV takes them."""
    return round(16 * float(point[0])), round(16 * float(point[1]))


def _fill(mask: np.ndarray, corners: np.ndarray) -> None:
    cv2.fillPoly(mask, [np.round(16 * corners).astype(np.int32)], 255, cv2.LINE_AA, 4)
