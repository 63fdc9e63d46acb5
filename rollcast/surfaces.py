"""Surfaces as exact geometry: nearest points, normals, heights.

The simulator asks for contacts (nearest points with normals), the renderer for heights and
normals under every pixel. A surface knows nothing of balls' motion or of images.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from rollcast.camera import HEIGHTFIELD_HALF_WIDTH_M
from rollcast.perlin import Coordinate, noise_and_gradient, noise_derivatives
from rollcast.scene import Scene, Vector3

BOWL_RADIUS_M = 1.0
NOISE_AMPLITUDE_M = 0.2
"""Height of the heightfield per unit of noise; calibrated, see docs/decisions/0014."""


_TOUCH_M = 1e-3
"""A ball that is let down onto a surface may stand this deep in it."""


class Contact(NamedTuple):
    """A point of a surface that is locally nearest to a ball's centre, in world metres."""

    point: Vector3
    normal: Vector3
    """Unit normal that points to the side where the balls are."""


class Surface(Protocol):
    """Interface of all surfaces."""

    def contacts(self, centre: Vector3, radius: float) -> list[Contact]:
        """Local minima of the distance to ``centre`` that a ball of ``radius`` could touch."""
        ...

    def clears(self, centre: Vector3, radius: float) -> bool:
        """Return whether a ball can start at ``centre``, outside the solid."""
        ...

    def height_and_normal(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Height z and unit normal over points of the plane; z is NaN where there is no surface."""
        ...


class EllipsoidalBowl:
    """Lower half of x^2/a^2 + y^2 + (z - 1)^2 = 1, turned about z (paper, section 3.1).

    Parameters
    ----------
    axis_ratio
        a, the semi-axis along the bowl's own x; 1 makes the hemisphere.
    rotation_rad
        Rotation about the world's z axis.
    """

    def __init__(self, axis_ratio: float, rotation_rad: float) -> None:
        self.axis_ratio = axis_ratio
        self._cos, self._sin = math.cos(rotation_rad), math.sin(rotation_rad)

    def _from_world(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        return self._cos * x + self._sin * y, self._cos * y - self._sin * x

    def _to_world(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        return self._cos * x - self._sin * y, self._sin * x + self._cos * y

    def point_at(self, polar_rad: float, azimuth_rad: float) -> Contact:
        """Surface point at angles (theta, phi) from the bowl's centre, theta = pi at the bottom."""
        x = self.axis_ratio * math.sin(polar_rad) * math.cos(azimuth_rad)
        y = math.sin(polar_rad) * math.sin(azimuth_rad)
        return self._contact(x, y, math.cos(polar_rad))

    def contacts(self, centre: Vector3, radius: float) -> list[Contact]:  # noqa: ARG002
        """Return the nearest point of the whole ellipsoid (one: balls are rounder than the bowl).

        With rho = sqrt(y^2 + (z-1)^2) the nearest point is (a^2 x / (t + a^2), rho / (t + 1)) for
        the largest root t of (a x / (t + a^2))^2 + (rho / (t + 1))^2 = 1, which is convex and
        falling there, so Newton's method from the left never overshoots.
        """
        x, y = self._from_world(centre[0], centre[1])
        # On the plane between its long sides a bowl has two nearest points: take either.
        x = math.copysign(max(abs(x), 1e-9), x)
        z = centre[2] - BOWL_RADIUS_M
        a = self.axis_ratio
        ax, rho = a * abs(x), math.hypot(y, z)
        t = max(ax - a * a, rho - 1)
        for _ in range(50):
            u, v = ax / (t + a * a), rho / (t + 1)
            excess = u * u + v * v - 1
            if excess < 1e-14:
                break
            t += excess / (2 * (u * u / (t + a * a) + v * v / (t + 1)))
        return [self._contact(a * a * x / (t + a * a), y / (t + 1), z / (t + 1))]

    def clears(self, centre: Vector3, radius: float) -> bool:
        """Return whether a ball can start at ``centre``: in the bowl, clear of its wall."""
        return _clearance(self.contacts(centre, radius)[0], centre) >= radius - _TOUCH_M

    def _contact(self, x: float, y: float, z: float) -> Contact:
        """Contact at a point given in the bowl's own axes, z from the bowl's centre."""
        nx, ny, nz = -x / self.axis_ratio**2, -y, -z
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny = self._to_world(nx / length, ny / length)
        x, y = self._to_world(x, y)
        return Contact((x, y, z + BOWL_RADIUS_M), (nx, ny, nz / length))

    def height_and_normal(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Height z and unit normal over points of the plane; z is NaN outside the rim."""
        x, y = self._from_world(x, y)
        squared = 1 - (x / self.axis_ratio) ** 2 - y**2
        z = -np.sqrt(np.where(squared >= 0, squared, np.nan))
        nx, ny = self._to_world(-x / self.axis_ratio**2, -y)
        normal = np.stack([nx, ny, -z], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return z + BOWL_RADIUS_M, normal

    def angles(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
        """Surface coordinates for a texture: polar angle from the bottom and azimuth, radians."""
        x, y = self._from_world(x, y)
        x = x / self.axis_ratio
        return np.arcsin(np.minimum(np.hypot(x, y), 1)), np.arctan2(y, x)


class Heightfield:
    """z = amplitude * noise((R(x, y) + offset) / scale): improved Perlin noise (paper, 3.2).

    Parameters
    ----------
    noise_scale
        Side of a lattice cell, metres.
    noise_offset_m
        The point of the noise plane under the camera.
    rotation_rad
        Rotation of the noise plane about the camera's axis.
    """

    # The search grid resolves the tightest landscape (scale 0.2) with five points a cell.
    _GRID_STEP_M = 0.04
    _GRID_MARGIN_M = 0.3
    # Two minima nearer than this are one contact of the ball.
    _MERGE_M = 0.01
    # A contact further from the ball than this cannot matter before the next step.
    _REACH_M = 0.03

    def __init__(
        self, noise_scale: float, noise_offset_m: tuple[float, float], rotation_rad: float
    ) -> None:
        self._scale = noise_scale
        self._offset = noise_offset_m
        self._cos, self._sin = math.cos(rotation_rad), math.sin(rotation_rad)
        half = HEIGHTFIELD_HALF_WIDTH_M + self._GRID_MARGIN_M
        self._axis = np.arange(-half, half + self._GRID_STEP_M / 2, self._GRID_STEP_M)
        x, y = np.meshgrid(self._axis, self._axis, indexing="ij")
        self._grid = self.height_and_normal(x, y)[0]

    def _to_noise(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        return (
            (self._cos * x + self._sin * y + self._offset[0]) / self._scale,
            (self._cos * y - self._sin * x + self._offset[1]) / self._scale,
        )

    def _local(self, x: float, y: float) -> tuple[float, float, float, float, float, float]:
        """Height, gradient and Hessian (h, h_x, h_y, h_xx, h_xy, h_yy) at one world point."""
        n, nu, nv, nuu, nuv, nvv = noise_derivatives(*self._to_noise(x, y))
        c, s = self._cos, self._sin
        first = NOISE_AMPLITUDE_M / self._scale
        second = first / self._scale
        return (
            NOISE_AMPLITUDE_M * n,
            first * (c * nu - s * nv),
            first * (s * nu + c * nv),
            second * (c * c * nuu - 2 * c * s * nuv + s * s * nvv),
            second * (c * s * (nuu - nvv) + (c * c - s * s) * nuv),
            second * (s * s * nuu + 2 * c * s * nuv + c * c * nvv),
        )

    def contact_at(self, x: float, y: float) -> Contact:
        """Surface point straight below or above (x, y)."""
        h, hx, hy, *_ = self._local(x, y)
        length = math.sqrt(1 + hx * hx + hy * hy)
        return Contact((x, y, h), (-hx / length, -hy / length, 1 / length))

    def resting_height(self, x: float, y: float, radius: float) -> float:
        """Height of a ball's centre when it is let down at (x, y) until it touches.

        Sphere tracing from above: the distance to the surface is always a safe step (paper, 3.2).
        """
        z = float(self._grid.max()) + radius
        for _ in range(1000):
            contacts = self.contacts((x, y, z), radius)
            gap = math.dist(contacts[0].point, (x, y, z)) - radius if contacts else self._REACH_M
            if gap < 1e-6:
                break
            z -= gap
        return z

    def clears(self, centre: Vector3, radius: float) -> bool:
        """Return whether a ball can start at ``centre``: within the walls and above the ground."""
        room = HEIGHTFIELD_HALF_WIDTH_M - radius + _TOUCH_M
        if max(abs(centre[0]), abs(centre[1])) > room:
            return False
        below = self.contact_at(centre[0], centre[1])
        touched = self.contacts(centre, radius)
        return centre[2] > below.point[2] and all(
            _clearance(contact, centre) >= radius - _TOUCH_M for contact in touched
        )

    def contacts(self, centre: Vector3, radius: float) -> list[Contact]:
        """All local minima of the distance within reach, nearest first."""
        found: list[tuple[float, Contact]] = []
        for x, y in self._candidates(centre, radius):
            contact = self._refine(x, y, centre)
            if contact is None:
                continue
            distance = math.dist(contact.point, centre)
            if distance > radius + self._REACH_M:
                continue
            if all(math.dist(contact.point, other.point) > self._MERGE_M for _, other in found):
                found.append((distance, contact))
        found.sort(key=lambda entry: entry[0])
        return [contact for _, contact in found]

    def _candidates(self, centre: Vector3, radius: float) -> list[tuple[float, float]]:
        """Grid points under the ball whose distance to its centre is a local minimum."""
        reach = radius + self._REACH_M + 2 * self._GRID_STEP_M
        first = float(self._axis[0])
        i0, i1, j0, j1 = (
            min(max(round((value - first) / self._GRID_STEP_M), 1), len(self._axis) - 2)
            for value in (
                centre[0] - reach, centre[0] + reach, centre[1] - reach, centre[1] + reach,
            )
        )  # fmt: skip
        rows, columns = slice(i0 - 1, i1 + 2), slice(j0 - 1, j1 + 2)
        dx = self._axis[rows] - centre[0]
        dy = self._axis[columns] - centre[1]
        dz = self._grid[rows, columns] - centre[2]
        squared = dz * dz
        squared += (dx * dx)[:, None]
        squared += (dy * dy)[None, :]
        inner = squared[1:-1, 1:-1]
        lowest = (
            (inner <= squared[:-2, 1:-1])
            & (inner <= squared[2:, 1:-1])
            & (inner <= squared[1:-1, :-2])
            & (inner <= squared[1:-1, 2:])
            & (inner < reach * reach)
        )
        return [
            (float(self._axis[i0 + i]), float(self._axis[j0 + j])) for i, j in np.argwhere(lowest)
        ]

    def _refine(self, x: float, y: float, centre: Vector3) -> Contact | None:
        """Damped Newton's method on half the squared distance; None when it does not settle."""
        shape = self._local(x, y)
        for _ in range(40):
            h, hx, hy, hxx, hxy, hyy = shape
            gap = h - centre[2]
            fx, fy = x - centre[0] + gap * hx, y - centre[1] + gap * hy
            a, b, d = 1 + hx * hx + gap * hxx, hx * hy + gap * hxy, 1 + hy * hy + gap * hyy
            lowest = 0.5 * (a + d) - math.hypot(0.5 * (a - d), b)
            if lowest <= 0:
                # Not convex here: bend it until it is.
                a, d = a + 0.1 - lowest, d + 0.1 - lowest
            determinant = a * d - b * b
            sx, sy = (b * fy - d * fx) / determinant, (b * fx - a * fy) / determinant
            length = math.hypot(sx, sy)
            if length > self._GRID_STEP_M:
                sx, sy = sx * self._GRID_STEP_M / length, sy * self._GRID_STEP_M / length
            if length < 1e-7:
                return self.contact_at(x + sx, y + sy)
            before = math.dist((x, y, h), centre)
            for _ in range(12):
                shape = self._local(x + sx, y + sy)
                if math.dist((x + sx, y + sy, shape[0]), centre) <= before + 1e-12:
                    break
                sx, sy = sx / 2, sy / 2
            x, y = x + sx, y + sy
        return None

    def height_and_normal(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Height z and unit normal over points of the plane."""
        n, nu, nv = noise_and_gradient(*self._to_noise(x, y))
        slope = NOISE_AMPLITUDE_M / self._scale
        hx = slope * (self._cos * nu - self._sin * nv)
        hy = slope * (self._sin * nu + self._cos * nv)
        normal = np.stack([-hx, -hy, np.ones_like(hx)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return NOISE_AMPLITUDE_M * n, normal


class Table:
    """The plane z = slope_x x + slope_y y between four vertical walls.

    Parameters
    ----------
    slope
        Rise per metre along the world's x and y.
    walls_m
        Left, bottom, right and top wall, world x and y.
    """

    def __init__(
        self, slope: tuple[float, float], walls_m: tuple[float, float, float, float]
    ) -> None:
        self.walls_m = walls_m
        self._slope = slope
        length = math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
        self._normal = (-slope[0] / length, -slope[1] / length, 1 / length)

    def contact_at(self, x: float, y: float) -> Contact:
        """Surface point straight below or above (x, y)."""
        return Contact((x, y, self._slope[0] * x + self._slope[1] * y), self._normal)

    def contacts(self, centre: Vector3, radius: float) -> list[Contact]:  # noqa: ARG002
        """Return the nearest point of the plane."""
        gap = _clearance(self.contact_at(centre[0], centre[1]), centre)
        x, y, z = (c - gap * n for c, n in zip(centre, self._normal, strict=True))
        return [Contact((x, y, z), self._normal)]

    def clears(self, centre: Vector3, radius: float) -> bool:
        """Return whether a ball can start at ``centre``: above the table and within the walls."""
        left, bottom, right, top = self.walls_m
        sides = (centre[0] - left, right - centre[0], centre[1] - bottom, top - centre[1])
        if min(sides) < radius - _TOUCH_M:
            return False
        below = self.contact_at(centre[0], centre[1])
        return _clearance(below, centre) >= radius - _TOUCH_M

    def height_and_normal(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Height z and unit normal over points of the plane."""
        z = self._slope[0] * x + self._slope[1] * y
        return z, np.broadcast_to(np.array(self._normal), (*z.shape, 3))


def _clearance(contact: Contact, centre: Vector3) -> float:
    """Signed distance of a point from the tangent plane of a contact."""
    gaps = zip(contact.normal, centre, contact.point, strict=True)
    return sum(n * (c - p) for n, c, p in gaps)


def surface_of(scene: Scene) -> EllipsoidalBowl | Heightfield | Table:
    """Build the surface that a scene describes."""
    if scene.slope is not None:
        assert scene.walls_m is not None
        return Table(scene.slope, scene.walls_m)
    if scene.axis_ratio is not None:
        return EllipsoidalBowl(scene.axis_ratio, scene.rotation_rad)
    assert scene.noise_scale is not None
    assert scene.noise_offset_m is not None
    return Heightfield(scene.noise_scale, scene.noise_offset_m, scene.rotation_rad)
