# pyright: standard
"""Colours of balls: histograms in CIE Lab."""

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

COLORED = 0.85
"""Part of the radius within which colours are a ball's own."""
BINS = (4, 16, 16)
"""Number of bins of lightness and of the two colour axes of CIE Lab."""
BIN_WIDTHS = (64, 16, 16)
COLORS = BINS[0] * BINS[1] * BINS[2]


def colors_at(
    picture: UInt8[np.ndarray, "height width 3"],
    positions_px: Float[np.ndarray, "balls 2"],
    radii_px: Float[np.ndarray, " balls"],
) -> Float32[np.ndarray, "balls colors"]:
    """Return the shares of the pixels of discs by colour."""
    shares = np.zeros((len(radii_px), COLORS), np.float32)
    for row, (centre, radius) in enumerate(zip(positions_px, radii_px, strict=True)):
        reach = max(COLORED * float(radius), 0.75)
        low = np.maximum(np.floor(centre - reach), 0).astype(int)
        high = np.minimum(np.ceil(centre + reach), [picture.shape[1], picture.shape[0]]).astype(int)
        if (high <= low).any():
            continue
        part = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
        inside = np.hypot(x - centre[0], y - centre[1]) <= reach
        bins = cv2.cvtColor(part, cv2.COLOR_RGB2Lab)[inside] // np.array(BIN_WIDTHS, np.uint8)
        counts = np.bincount(np.ravel_multi_index(tuple(bins.T), BINS), minlength=COLORS)
        shares[row] = counts / max(1, int(counts.sum()))
    return shares


def mean_lab(palette: Float[np.ndarray, " colors"]) -> Float[np.ndarray, "3"]:
    """Return the mean colour of a histogram, as OpenCV's 8-bit CIE Lab."""
    centres = [(np.arange(n) + 0.5) * w for n, w in zip(BINS, BIN_WIDTHS, strict=True)]
    grid = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1).reshape(-1, 3)
    return palette @ grid


def hue(palette: Float[np.ndarray, " colors"]) -> float:
    """Angle in the plane of CIE Lab's colour axes, from pink over red, yellow and green to blue."""
    _, a, b = mean_lab(palette) - 128
    return float(np.arctan2(b, a) % (2 * np.pi))


def as_hex(palette: Float[np.ndarray, " colors"]) -> str:
    """Return the mean colour of a histogram as ``#rrggbb``."""
    lab = mean_lab(palette).clip(0, 255).astype(np.uint8).reshape(1, 1, 3)
    red, green, blue = cv2.cvtColor(lab, cv2.COLOR_Lab2RGB)[0, 0]
    return f"#{red:02x}{green:02x}{blue:02x}"
