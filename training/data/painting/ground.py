"""Paints grounds: colours of a plane before light falls on it, 128 x 128 pixels."""

import math

import cv2
import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.simulation.appearance import GroundAppearance

SIZE = NETWORK_FRAME_SIZE
Image = Float[np.ndarray, "size size 3"]

_ALONG = np.arange(SIZE, dtype=np.float32) + 0.5 - SIZE / 2
_LETTERS = "ABCDEFGHIKLMNOPRSTUVWXYZ0123456789-:."
_SUPERSAMPLES = 3
"""Samples per pixel and axis of an edge, along one axis."""


def paint_ground(appearance: GroundAppearance) -> Image:
    """Paint a ground, float32 intensities 0..1."""
    generator = np.random.default_rng(appearance.seed)
    first, second, third = np.asarray(appearance.colors, np.float32)
    image = _pattern(appearance, generator, first, second, third)
    if appearance.grain:
        grain = smooth_noise(generator, float(generator.choice([1.0, 1.5, 3.0])))
        image = image * (1 + 2 * appearance.grain * grain[..., None])
    return np.clip(image, 0, 1).astype(np.float32)


def _pattern(
    appearance: GroundAppearance,
    generator: np.random.Generator,
    first: np.ndarray,
    second: np.ndarray,
    third: np.ndarray,
) -> np.ndarray:
    cos, sin = math.cos(appearance.angle_rad), math.sin(appearance.angle_rad)
    u = cos * _ALONG[None, :] + sin * _ALONG[:, None]
    v = cos * _ALONG[:, None] - sin * _ALONG[None, :]
    plain = np.full((SIZE, SIZE, 3), first, np.float32)
    match appearance.pattern:
        case "cloth":
            weave = smooth_noise(generator, 1.0) + smooth_noise(generator, 8.0)
            return plain * (1 + 0.06 * weave[..., None])
        case "wood":
            warp = 2 * smooth_noise(generator, 24.0)
            rings = np.sin(u / max(appearance.scale, 4) * 4 + warp)
            return _between(first, second, 0.5 + 0.5 * rings)
        case "paper":
            return plain * (1 + 0.04 * smooth_noise(generator, 20.0)[..., None])
        case "checkers":
            side = max(appearance.scale, 4)
            return _between(first, second, _square_wave(u, side) * _square_wave(v, side) / 2 + 0.5)
        case "stripes":
            return _between(first, second, _square_wave(u, max(appearance.scale, 3)) / 2 + 0.5)
        case "lines":
            return _lines(plain, second, appearance, generator)
        case "gradient":
            return _between(first, second, np.clip(u / (1.4 * SIZE) + 0.5, 0, 1))
        case "marble":
            noise = smooth_noise(generator, appearance.scale) + 0.5 * smooth_noise(
                generator, appearance.scale / 3
            )
            mixed = _between(first, second, np.clip(0.5 + 0.5 * noise, 0, 1))
            return mixed + 0.3 * np.clip(noise - 0.8, 0, 1)[..., None] * (third - mixed)
        case "shapes":
            return _shapes(plain, appearance, generator)
        case "rings":
            middle = generator.uniform(-40, 40, 2)
            radius = np.hypot(_ALONG[None, :] - middle[0], _ALONG[:, None] - middle[1])
            return _between(first, second, _square_wave(radius, max(appearance.scale, 4)) / 2 + 0.5)
        case "text":
            return _texts(plain, second, generator)
        case _:
            return plain


def smooth_noise(generator: np.random.Generator, cell: float) -> Float[np.ndarray, "size size"]:
    """Noise of unit variance at its nodes, which are ``cell`` pixels apart."""
    nodes = max(int(SIZE / max(cell, 1)) + 2, 3)
    coarse = generator.standard_normal((nodes, nodes), dtype=np.float32)
    if nodes >= SIZE:
        return coarse[:SIZE, :SIZE]
    return cv2.resize(coarse, (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)


def _square_wave(u: np.ndarray, side: float) -> np.ndarray:
    """-1 and 1 in turns, each ``side`` pixels long, with edges a pixel wide."""
    phase = np.abs((u / side) % 2 - 1) - 0.5
    return np.clip(2 * phase * side, -1, 1)


def _between(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    return first + share[..., None].astype(np.float32) * (second - first)


def _levels(image: np.ndarray) -> np.ndarray:
    return np.clip(255 * image, 0, 255).astype(np.uint8, order="C")


def _tuple(color: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = (255 * np.clip(color, 0, 1)).tolist()
    return red, green, blue


def _lines(
    plain: np.ndarray,
    color: np.ndarray,
    appearance: GroundAppearance,
    generator: np.random.Generator,
) -> np.ndarray:
    canvas = _levels(plain)
    for _ in range(generator.integers(1, 12)):
        ends = generator.integers(-20 * 16, (SIZE + 20) * 16, (2, 2))
        if generator.random() < 0.4:  # drawn tables have lines along their sides
            ends[1, generator.integers(2)] = ends[0, 0]
        thickness = int(generator.integers(1, 3))
        cv2.line(
            canvas, ends[0].tolist(), ends[1].tolist(), _tuple(color), thickness, cv2.LINE_AA, 4
        )
    for _ in range(generator.integers(0, 3)):
        centre = generator.integers(0, SIZE * 16, 2).tolist()
        radius = int(appearance.scale * 16)
        cv2.circle(canvas, centre, radius, _tuple(color), 1, cv2.LINE_AA, 4)
    return canvas.astype(np.float32) / 255


def _shapes(
    plain: np.ndarray, appearance: GroundAppearance, generator: np.random.Generator
) -> np.ndarray:
    """Dead leaves: shapes over shapes have the statistics of natural pictures."""
    canvas = _levels(plain)
    palette = np.asarray(appearance.colors)
    for _ in range(generator.integers(8, 40)):
        color = palette[generator.integers(3)] + generator.normal(0, 0.1, 3)
        size = max(appearance.scale * generator.exponential(0.7), 1.5)
        draw_shape(canvas, generator, generator.uniform(0, SIZE, 2), size, color)
    return canvas.astype(np.float32) / 255


def draw_shape(
    canvas: np.ndarray,
    generator: np.random.Generator,
    middle: np.ndarray,
    size: float,
    color: np.ndarray,
) -> None:
    """Draw an ellipse or polygon into 8-bit RGB (or a mask), in place."""
    if generator.random() < 0.4:
        axes = (16 * size * generator.uniform(0.3, 1, 2)).astype(int).tolist()
        cv2.ellipse(
            canvas, (16 * middle).astype(int).tolist(), axes, float(generator.uniform(0, 180)),
            0, 360, _tuple(color), -1, cv2.LINE_AA, 4,
        )  # fmt: skip
        return
    corners = generator.integers(3, 7) if generator.random() < 0.5 else 4
    angles = np.sort(generator.uniform(0, 2 * math.pi, corners))
    if corners == 4:
        aside = generator.uniform(0.2, 1.2)
        turn = generator.uniform(0, math.pi)
        angles = turn + np.array([-aside, aside, math.pi - aside, math.pi + aside]) / 2
    points = middle + size * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cv2.fillPoly(canvas, [(16 * points).astype(np.int32)], _tuple(color), cv2.LINE_AA, 4)


def _texts(plain: np.ndarray, color: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    canvas = _levels(plain)
    for _ in range(generator.integers(1, 7)):
        draw_text(canvas, generator, generator.integers(0, SIZE, 2), color)
    return canvas.astype(np.float32) / 255


def draw_text(
    canvas: np.ndarray, generator: np.random.Generator, at: np.ndarray, color: np.ndarray
) -> None:
    """Write something into 8-bit RGB, in place."""
    letters = [_LETTERS[k] for k in generator.integers(len(_LETTERS), size=10)]
    cv2.putText(
        canvas, "".join(letters), at.tolist(), int(generator.integers(0, 7)),
        float(generator.uniform(0.25, 1.0)), _tuple(color), int(generator.integers(1, 3)),
        cv2.LINE_AA,
    )  # fmt: skip
