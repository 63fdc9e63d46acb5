"""Improved Perlin noise in two dimensions with exact first and second derivatives.

After K. Perlin, "Improving noise" (2002): quintic fade, gradients chosen by a fixed permutation.
"""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

_PERIOD = 256
_DIRECTIONS = 16

Coordinate = TypeVar("Coordinate", float, np.ndarray)
"""One point at a time or many at once: the same formulas serve both."""


def _lattice_gradients() -> np.ndarray:
    """Make the lattice's unit gradients [256, 256, 2]: one fixed landscape for all scenes."""
    permutation = np.random.default_rng(2002).permutation(_PERIOD)
    rows, columns = np.meshgrid(np.arange(_PERIOD), np.arange(_PERIOD), indexing="ij")
    hashed = permutation[(permutation[rows] + columns) % _PERIOD] % _DIRECTIONS
    angles = 2 * np.pi * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)[hashed]


_GRADIENTS = _lattice_gradients()
_GRADIENT_LISTS = _GRADIENTS.tolist()
"""Gradients as nested lists, in which single look-ups are ten times faster than in an array."""


def _fade(t: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
    """Quintic fade 6 t^5 - 15 t^4 + 10 t^3 with its first and second derivative."""
    s = t - 1
    return t * t * t * (t * (6 * t - 15) + 10), 30 * t * t * s * s, 60 * t * s * (2 * t - 1)


def _blend(
    x: Coordinate,
    y: Coordinate,
    g00: Sequence[Coordinate],
    g10: Sequence[Coordinate],
    g01: Sequence[Coordinate],
    g11: Sequence[Coordinate],
) -> tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]:
    """Height, gradient and Hessian inside a cell, (x, y) in 0..1, from its corners' gradients."""
    d00 = g00[0] * x + g00[1] * y
    d10 = g10[0] * (x - 1) + g10[1] * y
    d01 = g01[0] * x + g01[1] * (y - 1)
    d11 = g11[0] * (x - 1) + g11[1] * (y - 1)
    u, du, ddu = _fade(x)
    v, dv, ddv = _fade(y)
    # n = d00 + u (d10 - d00) + v (d01 - d00) + u v (d00 - d10 - d01 + d11), derived term by term.
    a, b, c = d10 - d00, d01 - d00, d00 - d10 - d01 + d11
    ax, ay = g10[0] - g00[0], g10[1] - g00[1]
    bx, by = g01[0] - g00[0], g01[1] - g00[1]
    cx, cy = g00[0] - g10[0] - g01[0] + g11[0], g00[1] - g10[1] - g01[1] + g11[1]
    n = d00 + u * a + v * b + u * v * c
    nx = g00[0] + du * (a + v * c) + u * (ax + v * cx) + v * bx
    ny = g00[1] + dv * (b + u * c) + v * (by + u * cy) + u * ay
    nxx = ddu * (a + v * c) + 2 * du * (ax + v * cx)
    nyy = ddv * (b + u * c) + 2 * dv * (by + u * cy)
    nxy = du * (ay + dv * c + v * cy) + u * dv * cx + dv * bx
    return n, nx, ny, nxx, nxy, nyy


def noise_derivatives(x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Noise at one point with its derivatives: n, n_x, n_y, n_xx, n_xy, n_yy (cell units)."""
    i, j = math.floor(x), math.floor(y)
    row, next_row = _GRADIENT_LISTS[i % _PERIOD], _GRADIENT_LISTS[(i + 1) % _PERIOD]
    k, m = j % _PERIOD, (j + 1) % _PERIOD
    return _blend(x - i, y - j, row[k], next_row[k], row[m], next_row[m])


def noise_and_gradient(
    x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise n, n_x and n_y at many points at once (cell units)."""
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)

    def corner(di: int, dj: int) -> tuple[np.ndarray, np.ndarray]:
        gradient = _GRADIENTS[(i + di) % _PERIOD, (j + dj) % _PERIOD]
        return gradient[..., 0], gradient[..., 1]

    return _blend(x - i, y - j, corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1))[:3]
