"""Renders scenes as the overhead camera sees them (paper, section "Experimental Setup").

Bowls carry a checkerboard under white environment light; the ellipsoid adds a lamp at the
camera. Heightfields are lit by a small area light. The shaded background is made once a scene;
every ball is then composed into a small patch.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, UInt8

from rollcast.camera import Camera
from rollcast.scene import PALETTE, Scene
from rollcast.surfaces import EllipsoidalBowl, Heightfield, Table, surface_of
from rollcast.trajectory import Trajectory

_SUPERSAMPLES = 2
"""Background samples per pixel and axis."""
_STRIP_SAMPLES = 2**16
"""Samples that are shaded at once: those of a frame of 128 pixels. The intermediate arrays of
larger frames would take a gigabyte."""

_CHECKER_SIDE_RAD = math.pi / 10
_CHECKER_COLORS = np.array([[0.92, 0.92, 0.90], [0.22, 0.26, 0.32]])
GROUND_COLOR = np.array([0.80, 0.76, 0.70])
_CLOTH_COLOR, _CUSHION_COLOR = np.array([0.16, 0.46, 0.32]), np.array([0.36, 0.22, 0.12])
BEYOND_COLOR = np.array([0.05, 0.05, 0.05])
"""Outside the rim of a bowl."""

# Body octants of the textured ball, told apart by the signs of the body's x, y and z.
_TEXTURE_COLORS = np.array(
    [
        [[[0.85, 0.10, 0.10], [0.95, 0.75, 0.10]], [[0.10, 0.55, 0.20], [0.10, 0.70, 0.85]]],
        [[[0.15, 0.20, 0.75], [0.95, 0.95, 0.95]], [[0.70, 0.20, 0.70], [0.95, 0.45, 0.10]]],
    ]
)
_BALL_COLORS = np.array(list(PALETTE.values()))
_DIFFUSE, _SPECULAR, _SHININESS = 0.8, 0.5, 30
"""Coloured balls (paper, section 3.1): Phong with a diffuse and a specular intensity."""

_LIGHT_SIDE_M = 0.1
_LIGHT_POWER = 4.5
AMBIENT_ON_HEIGHTFIELD = 0.12
_SHADOW_STEPS = 16


@dataclass(frozen=True)
class _Lighting:
    """Environment and lamp intensities of a scenario."""

    environment: float
    camera_lamp: float = 0.0


_LIGHTING = {
    "hemisphere": _Lighting(environment=0.7),
    "ellipsoid": _Lighting(environment=0.2, camera_lamp=0.8),
    "table": _Lighting(environment=0.3, camera_lamp=0.7),
}


_Box = tuple[slice, slice]
"""Rows and columns of an image."""


class Materials(Protocol):
    """Another appearance of a scene whose shape and motion stay as they are."""

    ground: Float[np.ndarray, "size size 3"]
    """The lit scene without balls, intensities 0..1, float32."""
    ambient: Float[np.ndarray, "size size 3"]
    """Scene without balls in full shadow of the area light, if there is one."""

    def cast_shadow(
        self, image: Float[np.ndarray, "size size 3"], centre_px: np.ndarray, radius_px: float
    ) -> None:
        """Darken the ground around a ball in a scene without an area light."""
        ...

    def ball_color(
        self,
        normals: Float[np.ndarray, "rows columns 3"],
        body_normals: Float[np.ndarray, "rows columns 3"],
        light: Float[np.ndarray, "rows columns 1"],
        sharpness: float,
    ) -> Float[np.ndarray, "rows columns 3"] | None:
        """Colours of a ball's points, from normals in world and body axes; None for the scene's.

        Parameters
        ----------
        light
            The scene's light on the points.
        sharpness
            Radius in pixels.
        """
        ...


class Renderer:
    """Renders frames of one scene through one camera.

    Parameters
    ----------
    scene, camera
        Scene and viewpoint.
    empty
        The scene without balls, when an earlier renderer's :attr:`empty` is at hand: shading it is
        most of the work. Edges of balls and shadows may then be off by one level.
    """

    def __init__(
        self, scene: Scene, camera: Camera, empty: UInt8[np.ndarray, "size size 3"] | None = None
    ) -> None:
        self._scene = scene
        self._camera = camera
        self._surface = surface_of(scene)
        if empty is None:
            self._background = self._make_background()
            empty = _levels(self._background)
        else:
            self._background = empty.astype(np.float32) / 255
        self.empty = empty
        size = camera.image_size
        self._ground_points = np.empty((size, size, 3), np.float32)
        for rows in _strips(size):
            x, y = camera.pixel_centres_m(rows)
            height = self._surface.height_and_normal(x, y)[0]
            height = np.where(np.isnan(height), -np.inf, height)
            self._ground_points[rows] = np.stack([x, y, height], axis=-1)
        self._heights = self._ground_points[..., 2]

    def render(self, trajectory: Trajectory) -> UInt8[np.ndarray, "frames size size 3"]:
        """Render every frame of a trajectory."""
        return np.stack(
            [
                self._frame(positions, orientations)
                for positions, orientations in zip(
                    trajectory.positions_m, trajectory.orientations_xyzw, strict=True
                )
            ]
        )

    def render_with(
        self, trajectory: Trajectory, materials: Materials
    ) -> UInt8[np.ndarray, "frames size size 3"]:
        """Render every frame of a trajectory in another appearance."""
        states = zip(trajectory.positions_m, trajectory.orientations_xyzw, strict=True)
        return np.stack([_levels(self._frame_with(*state, materials)) for state in states])

    def _frame_with(
        self, positions: np.ndarray, orientations: np.ndarray, materials: Materials
    ) -> np.ndarray:
        image = materials.ground.copy()
        scale = self._camera.pixels_per_metre
        for position in positions:
            if self._scene.light_position_m is not None:
                self._cast_shadow(image, position, materials.ambient)
            else:
                radius_px = self._scene.radius_m * scale
                materials.cast_shadow(image, self._camera.project(position), radius_px)
        for index in np.argsort(positions[:, 2]):
            self._compose_ball(image, int(index), positions[index], orientations[index], materials)
        return image

    def light_on_ground(self) -> Float[np.ndarray, "size size"]:
        """Light on the ground under every pixel's centre, shadows of hills left out."""
        x, y = self._camera.pixel_centres_m()
        z, normals = self._surface.height_and_normal(x, y)
        return self._light_on(np.stack([x, y, z], axis=-1), normals)

    def _frame(self, positions: np.ndarray, orientations: np.ndarray) -> np.ndarray:
        image = self._background.copy()
        touched: list[_Box] = []
        if self._scene.light_position_m is not None:
            touched += [self._cast_shadow(image, position) for position in positions]
        # From low to high: with an orthographic camera above, the higher ball hides the lower.
        touched += [
            self._compose_ball(image, int(index), positions[index], orientations[index])
            for index in np.argsort(positions[:, 2])
        ]
        frame = self.empty.copy()
        for box in touched:
            frame[box] = _levels(image[box])
        return frame

    def _make_background(self) -> Float[np.ndarray, "size size 3"]:
        size = self._camera.image_size
        fine = Camera(self._camera.half_width_m, _SUPERSAMPLES * size)
        lowest = highest = 0.0
        if isinstance(self._surface, Heightfield):
            lowest, highest = self._terrain_range(fine)
        background = np.empty((size, size, 3), np.float32)
        for rows in _strips(fine.image_size):
            shaded = self._shaded(*fine.pixel_centres_m(rows), lowest, highest)
            blocks = shaded.reshape(-1, _SUPERSAMPLES, size, _SUPERSAMPLES, 3)
            strip = slice(rows.start // _SUPERSAMPLES, rows.stop // _SUPERSAMPLES)
            background[strip] = blocks.mean(axis=(1, 3))
        return background

    def _terrain_range(self, camera: Camera) -> tuple[float, float]:
        """Lowest and highest point of the ground, among those whose shadows are computed."""
        extremes: list[float] = []
        for rows in _strips(camera.image_size):
            x, y = (a[::_SUPERSAMPLES, ::_SUPERSAMPLES] for a in camera.pixel_centres_m(rows))
            z = self._surface.height_and_normal(x, y)[0]
            extremes += [float(z.min()), float(z.max())]
        return min(extremes), max(extremes)

    def _shaded(
        self,
        x: Float[np.ndarray, "rows columns"],
        y: Float[np.ndarray, "rows columns"],
        lowest: float,
        highest: float,
    ) -> Float[np.ndarray, "rows columns 3"]:
        """Lit ground at points of the plane; ``lowest`` and ``highest`` bound heightfields."""
        z, normals = self._surface.height_and_normal(x, y)
        points = np.stack([x, y, z], axis=-1)
        if isinstance(self._surface, EllipsoidalBowl):
            colors = _checkerboard(self._surface, x, y)
        elif isinstance(self._surface, Table):
            colors = _cloth(self._surface, x, y)
        else:
            colors = np.broadcast_to(GROUND_COLOR, points.shape)
        light = self._light_on(points, normals)
        if isinstance(self._surface, Heightfield):
            lamp = light - AMBIENT_ON_HEIGHTFIELD
            light = AMBIENT_ON_HEIGHTFIELD + lamp * self._terrain_visibility(
                points, lowest, highest
            )
        return np.where(np.isnan(z)[..., None], BEYOND_COLOR, colors * light[..., None])

    def _light_on(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Diffuse light on points with normals, before shadows."""
        if self._scene.light_position_m is None:
            lighting = _LIGHTING[self._scene.scenario]
            return lighting.environment + lighting.camera_lamp * np.maximum(normals[..., 2], 0)
        towards = np.asarray(self._scene.light_position_m) - points
        squared = np.sum(towards**2, axis=-1)
        facing = np.maximum(np.sum(towards * normals, axis=-1) / np.sqrt(squared), 0)
        # The lamp is a small square that faces down, so it shines with the cosine of its own angle.
        downwards = towards[..., 2] / np.sqrt(squared)
        return AMBIENT_ON_HEIGHTFIELD + _LIGHT_POWER * facing * downwards / squared

    def _terrain_visibility(self, points: np.ndarray, lowest: float, highest: float) -> np.ndarray:
        """Share of the area light that points of the ground see past the ground itself.

        Rays are followed until they are above every hill, on every second point of the supersampled
        grid: penumbrae are wider than that.
        """
        coarse = points[::_SUPERSAMPLES, ::_SUPERSAMPLES]
        light = np.asarray(self._scene.light_position_m)
        towards = light - coarse
        free = (highest - lowest) / (float(light[2]) - highest)
        clearance = np.full(coarse.shape[:-1], np.inf)
        for fraction in np.linspace(free / _SHADOW_STEPS, free, _SHADOW_STEPS):
            sample = coarse + fraction * towards
            ground = self._surface.height_and_normal(sample[..., 0], sample[..., 1])[0]
            # Height above ground in units of half the light's width as it appears from there.
            clearance = np.minimum(
                clearance, (sample[..., 2] - ground) / (0.5 * _LIGHT_SIDE_M * fraction)
            )
        visible = _smooth_step((clearance + 1) / 2)
        return visible.repeat(_SUPERSAMPLES, axis=0).repeat(_SUPERSAMPLES, axis=1)

    def _cast_shadow(
        self, image: np.ndarray, centre: np.ndarray, shaded: np.ndarray | None = None
    ) -> _Box:
        """Darken the ground where a ball stands between it and the area light."""
        box = self._shadow_box(centre)
        points = self._ground_points[box]
        towards = np.asarray(self._scene.light_position_m) - points
        to_ball = centre - points
        along = np.sum(towards * to_ball, axis=-1) / np.sum(towards**2, axis=-1)
        passing = np.linalg.norm(to_ball - along[..., None] * towards, axis=-1)
        penumbra = 0.5 * _LIGHT_SIDE_M * np.clip(along, 0.02, 1)
        visible = _smooth_step(((passing - self._scene.radius_m) / penumbra + 1) / 2)
        visible = np.where(along > 0, visible, 1.0)[..., None]
        patch = image[box]
        ambient = AMBIENT_ON_HEIGHTFIELD * GROUND_COLOR if shaded is None else shaded[box]
        ambient = np.minimum(patch, ambient)
        patch[:] = ambient + (patch - ambient) * visible
        return box

    def _shadow_box(self, centre: np.ndarray) -> _Box:
        """Pixels that a ball's shadow can reach: from the ball to where it meets lowest ground."""
        light = np.asarray(self._scene.light_position_m)
        lowest = self._ground_points[..., 2].min()
        stretch = (centre[2] - lowest) / (light[2] - centre[2])
        ends = np.stack([centre, centre + stretch * (centre - light)])
        spots = self._camera.project(ends)
        reach = (
            (1 + stretch) * (self._scene.radius_m + _LIGHT_SIDE_M) * self._camera.pixels_per_metre
        )
        size = self._camera.image_size
        left, top = np.clip(np.floor(spots.min(axis=0) - reach), 0, size).astype(int)
        right, bottom = np.clip(np.ceil(spots.max(axis=0) + reach), 0, size).astype(int)
        return slice(top, bottom), slice(left, right)

    def _compose_ball(
        self,
        image: np.ndarray,
        index: int,
        centre: np.ndarray,
        orientation: np.ndarray,
        materials: Materials | None = None,
    ) -> _Box:
        radius = self._scene.radius_m
        scale = self._camera.pixels_per_metre
        column, row = self._camera.project(centre)
        reach = radius * scale + 1
        top, bottom = _pixel_range(row, reach, len(image))
        left, right = _pixel_range(column, reach, len(image))
        x = ((np.arange(left, right) + 0.5 - column) / (radius * scale))[None, :]
        y = -((np.arange(top, bottom) + 0.5 - row) / (radius * scale))[:, None]
        distance = np.hypot(x, y)
        # Antialiased rim: how much of the pixel lies within the disc, to first order.
        coverage = np.clip((1 - distance) * radius * scale + 0.5, 0, 1)
        shrink = np.minimum(1, 1 / np.maximum(distance, 1e-9))
        x, y = x * shrink, y * shrink
        normals = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)
        box = slice(top, bottom), slice(left, right)
        hidden = centre[2] + radius * normals[..., 2] < self._heights[box]
        coverage = np.where(hidden, 0, coverage)[..., None]
        color = None
        if materials is not None:
            light = self._light_on(centre + radius * normals, normals)[..., None]
            turned = normals @ _rotation(orientation)
            color = materials.ball_color(normals, turned, light, radius * scale)
        if color is None:
            color = self._ball_color(index, normals, centre, orientation)
        image[box] += coverage * (color - image[box])
        return box

    def _ball_color(
        self, index: int, normals: np.ndarray, centre: np.ndarray, orientation: np.ndarray
    ) -> np.ndarray:
        light = self._light_on(centre + self._scene.radius_m * normals, normals)[..., None]
        if self._scene.textured:
            sharpness = self._scene.radius_m * self._camera.pixels_per_metre
            return light * _octant_colors(normals @ _rotation(orientation), sharpness)
        if self._scene.objects == 1:
            return light * np.ones(3)
        # The highlight is that of a lamp at the camera: the mirrored ray comes back along +z.
        highlight = _SPECULAR * np.maximum(2 * normals[..., 2:] ** 2 - 1, 0) ** _SHININESS
        return _DIFFUSE * light * _BALL_COLORS[index] / _BALL_COLORS.max() + highlight


def _strips(size: int) -> list[slice]:
    """Rows of a square image, in parts of at most _STRIP_SAMPLES points and whole pixels."""
    rows = max(_STRIP_SAMPLES // size // _SUPERSAMPLES, 1) * _SUPERSAMPLES
    return [slice(top, min(top + rows, size)) for top in range(0, size, rows)]


def _checkerboard(bowl: EllipsoidalBowl, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    polar, azimuth = bowl.angles(x, y)
    fields = np.floor(polar / _CHECKER_SIDE_RAD) + np.floor(azimuth / _CHECKER_SIDE_RAD)
    return _CHECKER_COLORS[(fields.astype(int) % 2)]


def _cloth(table: Table, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Cloth within the walls and cushions beyond them."""
    left, bottom, right, top = table.walls_m
    within = (left <= x) & (x <= right) & (bottom <= y) & (y <= top)
    return np.where(within[..., None], _CLOTH_COLOR, _CUSHION_COLOR)


def _octant_colors(body_normals: np.ndarray, sharpness: float) -> np.ndarray:
    """Colour of the texture at body directions; edges are one pixel wide."""
    weights = np.clip(0.5 + body_normals * sharpness / 2, 0, 1)
    x, y, z = weights[..., 0:1], weights[..., 1:2], weights[..., 2:3]
    c = _TEXTURE_COLORS
    low = (c[0, 0, 0] * (1 - z) + c[0, 0, 1] * z) * (1 - y) + (
        c[0, 1, 0] * (1 - z) + c[0, 1, 1] * z
    ) * y
    high = (c[1, 0, 0] * (1 - z) + c[1, 0, 1] * z) * (1 - y) + (
        c[1, 1, 0] * (1 - z) + c[1, 1, 1] * z
    ) * y
    return low * (1 - x) + high * x


def _rotation(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Matrix that turns body axes into world axes; ``v_world @ matrix`` gives body axes."""
    x, y, z, w = quaternion_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _levels(image: np.ndarray) -> np.ndarray:
    """Intensities 0..1 as the nearest of 256 levels."""
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)


def _smooth_step(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _pixel_range(centre: float, reach: float, size: int) -> tuple[int, int]:
    low = min(max(math.floor(centre - reach), 0), size)
    return low, min(max(math.ceil(centre + reach), low), size)
