"""Colours of balls, and balls painted into pictures without a scene.

Normals are unit vectors [..., 3]; view axes have z towards the camera.
"""

import math

import numpy as np
from jaxtyping import Float

from rollcast.simulation.appearance import BallAppearance, Lamp

Colors = Float[np.ndarray, "*batch 3"]


class BallPainter:
    """Colours of one ball's points."""

    def __init__(self, appearance: BallAppearance) -> None:
        self.appearance = appearance
        generator = np.random.default_rng(appearance.seed)
        self._axes = _orthonormal(generator)
        self._colors = np.asarray(appearance.colors, np.float32)
        self._octants = generator.random((2, 2, 2, 3)).astype(np.float32)
        spots = generator.normal(size=(generator.integers(3, 9), 3))
        self._spots = spots / np.linalg.norm(spots, axis=1, keepdims=True)
        self._width = generator.uniform(0.25, 0.7)

    def albedo(
        self, body_normals: Float[np.ndarray, "*batch 3"], sharpness: float
    ) -> Float[np.ndarray, "*batch 3"]:
        """Colours of body directions; edges are about one pixel wide.

        Parameters
        ----------
        sharpness
            Radius in pixels.
        """
        first, second, field = self._colors
        along = body_normals @ self._axes[0]
        match self.appearance.pattern:
            case "two-tone":
                return _mixed(first, second, along * sharpness)
            case "striped":
                return _mixed(second, first, (self._width - np.abs(along)) * sharpness)
            case "octants":
                return self._octant_colors(body_normals @ self._axes.T, sharpness)
            case "numbered":
                colors = _mixed(second, first, (self._width - np.abs(along)) * sharpness)
                if self.appearance.seed % 2:
                    colors = np.broadcast_to(first, colors.shape)
                across = body_normals @ self._axes[1:].T
                radius = np.hypot(across[..., 0], across[..., 1])
                inside = _weight((0.45 - radius) * sharpness)[..., None]
                digit = _weight((0.12 - np.abs(across[..., :1])) * sharpness) * _weight(
                    (0.3 - np.abs(across[..., 1:])) * sharpness
                )
                shown = field * (1 - 0.9 * digit)
                return colors + inside * (shown - colors)
            case "spots":
                nearest = (body_normals @ self._spots.T).max(axis=-1)
                return _mixed(first, second, (nearest - 0.9) * 2 * sharpness)
            case _:
                return np.broadcast_to(first, body_normals.shape)

    def _octant_colors(self, axes_xyz: np.ndarray, sharpness: float) -> np.ndarray:
        x, y, z = (_weight(axes_xyz[..., k : k + 1] * sharpness) for k in range(3))
        c = self._octants
        low, high = (
            (c[k, 0, 0] * (1 - z) + c[k, 0, 1] * z) * (1 - y)
            + (c[k, 1, 0] * (1 - z) + c[k, 1, 1] * z) * y
            for k in (0, 1)
        )
        return low * (1 - x) + high * x

    def lit(
        self,
        normals: Float[np.ndarray, "*batch 3"],
        body_normals: Float[np.ndarray, "*batch 3"],
        lamp: Lamp,
        sharpness: float,
    ) -> Float[np.ndarray, "*batch 3"]:
        """Colours under a lamp; normals are in the lamp's axes."""
        appearance = self.appearance
        direction = np.asarray(lamp.direction, np.float32)
        if appearance.pattern == "disc":
            return self._disc_colors(normals, body_normals, sharpness)
        if appearance.pattern == "metallic":
            # A studio of bright and dark stripes, mirrored.
            mirrored = 2 * normals[..., 2:] * normals - np.array([0, 0, 1], np.float32)
            bright = 0.5 + 0.5 * np.sin(4 * (mirrored @ self._axes[0]) + 2 * mirrored[..., 1])
            colors = self._colors[0] * (0.25 + 0.9 * bright[..., None])
        else:
            facing = np.maximum(normals @ direction, 0)[..., None]
            light = lamp.ambient + (1 - lamp.ambient) * facing
            colors = self.albedo(body_normals, sharpness) * light
        if appearance.gloss:
            half = direction + np.array([0, 0, 1], np.float32)
            half = half / np.linalg.norm(half)
            shine = np.maximum(normals @ half, 0) ** appearance.shininess
            colors = colors + appearance.gloss * shine[..., None]
        return colors

    def _disc_colors(
        self, normals: np.ndarray, body_normals: np.ndarray, sharpness: float
    ) -> np.ndarray:
        first, second, _ = self._colors
        distance = np.hypot(normals[..., 0], normals[..., 1])
        colors = _mixed(first, second, (distance - self._width - 0.25) * sharpness)
        # Which way the puck is turned: that of the body's x axis, flattened.
        dots = self._spots[:2, :2] * 0.6
        for dot in dots:
            away = np.hypot(body_normals[..., 0] - dot[0], body_normals[..., 1] - dot[1])
            inside = _weight((0.16 - away) * sharpness)
            colors = colors + inside[..., None] * (second - colors)
        return colors


def paint_ball(
    image: Float[np.ndarray, "height width 3"],
    painter: BallPainter,
    centre: Float[np.ndarray, "2"],
    radius: float,
    turn: Float[np.ndarray, "3 3"],
    lamp: Lamp,
    smear: Float[np.ndarray, "2"] | None = None,
) -> None:
    """Paint a ball into an image, in place.

    Parameters
    ----------
    centre
        Continuous pixel coordinates (x, y).
    turn
        Rotation from body to image axes.
    smear
        Way that the ball goes during the exposure, in pixels; the middle of it is at ``centre``.
    """
    height, width = image.shape[:2]
    way = np.zeros(2) if smear is None else np.asarray(smear)
    steps = 1 if smear is None else int(min(2 + math.hypot(*way) / 1.5, 6))
    reach_x, reach_y = radius + 1.5 + np.abs(way) / 2
    left, right = _range(centre[0], reach_x, width)
    top, bottom = _range(centre[1], reach_y, height)
    if left >= right or top >= bottom:
        return
    x = (np.arange(left, right, dtype=np.float32) + 0.5)[None, :]
    y = (np.arange(top, bottom, dtype=np.float32) + 0.5)[:, None]
    patch = image[top:bottom, left:right]
    total = np.zeros((*patch.shape[:2], 1), np.float32)
    colors = np.zeros(patch.shape, np.float32)
    for part in (np.arange(steps) + 0.5) / steps - 0.5:
        dx, dy = centre + part * way
        u, v = np.broadcast_arrays((x - dx) / radius, (y - dy) / radius)
        distance = np.sqrt(u * u + v * v)
        coverage = np.clip((1 - distance) * radius + 0.5, 0, 1)[..., None]
        shrink = np.minimum(1, 1 / np.maximum(distance, 1e-6))
        u, v = u * shrink, v * shrink
        normals = np.stack([u, v, np.sqrt((1 - u * u - v * v).clip(0))], axis=-1)
        normals = normals.astype(np.float32)
        painted = painter.lit(normals, _body_normals(painter, normals, turn), lamp, radius)
        if painter.appearance.pattern == "glass":
            edge = (0.25 + 0.6 * (1 - normals[..., 2:]) ** 2) * coverage
            highlight = np.maximum(painted - painter.appearance.colors[0], 0)
            total += edge / steps
            colors += (edge * painted * 0.8 + coverage * highlight * 0.5) / steps
            continue
        total += coverage / steps
        colors += coverage * painted / steps
    patch *= 1 - total
    patch += colors


def _body_normals(painter: BallPainter, normals: np.ndarray, turn: np.ndarray) -> np.ndarray:
    if painter.appearance.pattern == "disc":
        angle = math.atan2(turn[1, 0], turn[0, 0])
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return normals @ turn.astype(np.float32)


def cast_soft_shadow(
    image: Float[np.ndarray, "height width 3"],
    centre: Float[np.ndarray, "2"],
    radius: float,
    lamp: Lamp,
) -> None:
    """Darken the ground on a ball's side that is turned away from the lamp, in place."""
    if lamp.shadow == 0:
        return
    flat = np.asarray(lamp.direction[:2])
    middle = np.asarray(centre) - flat * radius * lamp.shadow_offset
    softness = max(lamp.shadow_softness * radius, 0.7)
    height, width = image.shape[:2]
    left, right = _range(middle[0], radius + softness, width)
    top, bottom = _range(middle[1], radius + softness, height)
    if left >= right or top >= bottom:
        return
    x = (np.arange(left, right, dtype=np.float32) + 0.5 - middle[0])[None, :]
    y = (np.arange(top, bottom, dtype=np.float32) + 0.5 - middle[1])[:, None]
    inside = np.clip((radius - np.sqrt(x * x + y * y)) / (2 * softness) + 0.5, 0, 1)
    image[top:bottom, left:right] *= (1 - lamp.shadow * inside)[..., None]


def rotation_about(axis: Float[np.ndarray, "3"], angle_rad: float) -> Float[np.ndarray, "3 3"]:
    """Matrix that turns by an angle about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross


def random_rotation(generator: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """Draw a rotation matrix, uniformly enough for textures."""
    return _orthonormal(generator)


def _orthonormal(generator: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    if np.linalg.det(q) < 0:
        q[0] = -q[0]
    return q.astype(np.float32)


def _weight(signed: np.ndarray) -> np.ndarray:
    """Share of a pixel beyond an edge, from the signed distance to it in pixels."""
    return np.clip(0.5 + signed, 0, 1)


def _mixed(zero: np.ndarray, one: np.ndarray, signed: np.ndarray) -> np.ndarray:
    return zero + _weight(signed)[..., None] * (one - zero)


def _range(centre: float, reach: float, size: int) -> tuple[int, int]:
    low = min(max(math.floor(centre - reach), 0), size)
    return low, min(max(math.ceil(centre + reach), low), size)
