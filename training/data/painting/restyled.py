"""The paper's scenes in another appearance: shapes and trajectories stay true."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Scene
from rollcast.simulation.appearance import (
    Appearance,
    BallAppearance,
    CameraPose,
    Clutter,
    draw_appearance,
    draw_ball,
    mean_color,
)
from rollcast.simulation.rendering import (
    AMBIENT_ON_HEIGHTFIELD,
    BEYOND_COLOR,
    GROUND_COLOR,
    Renderer,
)
from rollcast.surfaces import EllipsoidalBowl, surface_of
from rollcast.trajectory import OBSERVED_FRAMES, Trajectory
from training.data.painting.balls import BallPainter, cast_soft_shadow, paint_ball, random_rotation
from training.data.painting.camera import posed_frames, posed_points, shaken, unposed_points
from training.data.painting.clutter import clutter_mask, paint_clutter
from training.data.painting.ground import SIZE, paint_ground
from training.data.painting.sensor import through_sensor

CLEAR_PX = 2.0
"""Least distance of the balls' centres from the frame's border."""

_TRIES = 10


@dataclass(frozen=True)
class Restyling:
    """Appearance of one window of a scene of the paper.

    Attributes
    ----------
    ball
        None for the paper's texture.
    ground
        ``paper`` for the paper's colours, ``checkers`` for a bowl's fields in other colours and
        sizes, ``painted`` for a picture on the ground.
    fields_rad
        Side of the fields of ``checkers``.
    lamp
        Whether a bowl is lit by the appearance's lamp instead of the paper's light.
    resting
        Other balls: appearance, place and radius in pixels.
    seed
        Of orientations.
    """

    appearance: Appearance
    ball: BallAppearance | None
    ground: str
    fields_rad: float
    lamp: bool
    resting: tuple[tuple[BallAppearance, tuple[float, float], float], ...]
    seed: int


class RestyledWindow(NamedTuple):
    """Frames with the camera pose that moved their content."""

    frames: UInt8[np.ndarray, "frames size size 3"]
    pose: CameraPose
    shake: Float[np.ndarray, "frames 2"]
    """Shift of the picture, none in the last frame."""


def draw_restyling(
    generator: np.random.Generator,
    scene: Scene,
    path_px: Float[np.ndarray, "frames 2"],
) -> Restyling:
    """Draw the appearance of a window of a scene with one ball.

    Parameters
    ----------
    path_px
        Places of the ball in the paper's frames.
    """
    appearance = draw_appearance(generator, strength=0.8)
    bowl = scene.axis_ratio is not None
    kinds = ("paper", "checkers", "painted") if bowl else ("paper", "painted")
    ground = kinds[generator.integers(len(kinds))]
    beneath = mean_color(appearance.ground) if ground == "painted" else (0.5, 0.5, 0.5)
    ball = None if generator.random() < 0.35 else draw_ball(generator, apart_from=beneath)
    if ball is not None and generator.random() < 0.25:
        white = (1.0, 1.0, 1.0)  # as with ``textured=False``
        ball = replace(ball, pattern="plain", colors=(white, white, white), gloss=0.0)
    radius = scene.radius_m * camera_for(scene.scenario, SIZE).pixels_per_metre
    count = int(generator.choice([0, 1, 2, 4], p=[0.55, 0.25, 0.12, 0.08]))
    resting = tuple(
        other for _ in range(count) if (other := _draw_resting(generator, path_px, radius))
    )
    appearance = replace(
        appearance,
        camera=visible_pose(appearance.camera, path_px, bounded=bowl),
        clutter=tuple(c for c in appearance.clutter if not _hides(c, path_px, radius)),
    )
    return Restyling(
        appearance, ball, ground,
        fields_rad=math.pi / generator.uniform(4, 20),
        lamp=scene.light_position_m is None and generator.random() < 0.5,
        resting=resting,
        seed=int(generator.integers(2**31)),
    )  # fmt: skip


def _draw_resting(
    generator: np.random.Generator, path_px: np.ndarray, radius: float
) -> tuple[BallAppearance, tuple[float, float], float] | None:
    size = radius * generator.uniform(0.4, 1.4)
    for _ in range(_TRIES):
        at = generator.uniform(0, SIZE, 2)
        if np.linalg.norm(path_px - at, axis=1).min() > radius + size:
            return draw_ball(generator), (float(at[0]), float(at[1])), size
    return None


def visible_pose(pose: CameraPose, path_px: np.ndarray, *, bounded: bool) -> CameraPose:
    """Return the pose if the ball is in sight from there, or else the paper's.

    Parameters
    ----------
    path_px
        Places of the ball in the paper's frames.
    bounded
        Whether the frame shows all that there is.
    """
    if not bounded:
        pose = _within(pose)
    seen = posed_points(path_px, pose)
    return pose if seen.min() > CLEAR_PX and seen.max() < SIZE - CLEAR_PX else CameraPose()


def _within(pose: CameraPose) -> CameraPose:
    """Turn and shift a camera less and bring it nearer until it sees the paper's frame alone.

    There is no picture beyond that frame, and balls in a mirrored one would be unknown balls.
    """
    x, y = pose.offset
    pose = replace(pose, offset=(0.4 * x, 0.4 * y), rotation_rad=0.1 * pose.rotation_rad)
    along = np.linspace(0, SIZE, 5)
    grid = np.stack(np.meshgrid(along, along), axis=-1)
    for _ in range(_TRIES):
        furthest = np.abs(unposed_points(grid, pose) - SIZE / 2).max() / (SIZE / 2)
        if furthest <= 1:
            break
        pose = replace(pose, scale=1.02 * furthest * pose.scale)
    return pose


def _hides(thing: Clutter, path_px: np.ndarray, radius: float) -> bool:
    along = np.arange(SIZE) + 0.5
    for frame, (x, y) in enumerate(path_px):
        disc = np.hypot(along[None, :] - x, along[:, None] - y) <= radius + 1
        if (clutter_mask(thing, frame) * disc).sum() > 0.05 * disc.sum():
            return thing.kind != "shadow"
    return False


class _SceneMaterials:
    """Implementation of :class:`rollcast.simulation.rendering.Materials`."""

    def __init__(self, renderer: Renderer, scene: Scene, style: Restyling) -> None:
        self._style = style
        self._lamp = style.appearance.lamp
        self._painter = None if style.ball is None else BallPainter(style.ball)
        self.ground, self.ambient = _restyled_ground(renderer, scene, style)

    def cast_shadow(self, image: np.ndarray, centre_px: np.ndarray, radius_px: float) -> None:
        """Darken the ground where the lamp does not reach."""
        if self._style.lamp:
            cast_soft_shadow(image, centre_px, radius_px, self._lamp)

    def ball_color(
        self, normals: np.ndarray, body_normals: np.ndarray, light: np.ndarray, sharpness: float
    ) -> np.ndarray | None:
        """Colours of the ball's points."""
        if self._painter is None:
            return None
        if self._style.lamp:
            # A lamp's axes are the image's: y down.
            seen = normals * np.array([1, -1, 1])
            return self._painter.lit(seen, body_normals, self._lamp, sharpness)
        if self._painter.appearance.pattern in ("metallic", "disc"):
            lit = self._painter.lit(normals, body_normals, self._lamp, sharpness)
            return lit * light
        colors = self._painter.albedo(body_normals, sharpness) * light
        appearance = self._painter.appearance
        highlight = np.maximum(2 * normals[..., 2:] ** 2 - 1, 0) ** appearance.shininess
        return colors + appearance.gloss * highlight


def _restyled_ground(
    renderer: Renderer, scene: Scene, style: Restyling
) -> tuple[np.ndarray, np.ndarray]:
    """Lit ground without balls, and in full shadow of the area light."""
    appearance = style.appearance
    paper = renderer.empty.astype(np.float32) / 255
    if scene.scenario == "heightfield":
        albedo = np.broadcast_to(GROUND_COLOR.astype(np.float32), paper.shape)
        if style.ground == "painted":
            albedo = paint_ground(appearance.ground)
        image = albedo * (paper / GROUND_COLOR.astype(np.float32))
        ambient = AMBIENT_ON_HEIGHTFIELD * albedo
    else:
        image = _evenly_lit(renderer, scene, style, paper)
        ambient = image
    image = np.ascontiguousarray(image, dtype=np.float32)
    generator = np.random.default_rng(style.seed)
    for thing in appearance.clutter:
        if thing.kind not in ("hand", "cue", "shadow"):
            paint_clutter(image, thing, clutter_mask(thing, OBSERVED_FRAMES - 1))
    for resting, at, radius in style.resting:
        lamp = appearance.lamp
        cast_soft_shadow(image, np.asarray(at), radius, lamp)
        turn = random_rotation(generator)
        paint_ball(image, BallPainter(resting), np.asarray(at), radius, turn, lamp)
    return image, np.asarray(ambient, dtype=np.float32)


def _evenly_lit(
    renderer: Renderer, scene: Scene, style: Restyling, paper: np.ndarray
) -> np.ndarray:
    appearance = style.appearance
    fine = 2
    camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
    surface = surface_of(scene)
    x, y = camera.pixel_centres_m()
    z, normals = surface.height_and_normal(x, y)
    inside = (~np.isnan(z))[..., None]
    if style.lamp:
        lamp = appearance.lamp
        towards = np.asarray(lamp.direction) * (1, -1, 1)
        facing = np.maximum(np.nan_to_num(normals) @ towards, 0)
        light = (lamp.ambient + (1 - lamp.ambient) * facing)[..., None]
    else:
        light = np.nan_to_num(renderer.light_on_ground())[..., None]
    if style.ground == "paper":
        if not style.lamp:
            image = paper
        else:
            usual = np.nan_to_num(renderer.light_on_ground(), nan=1.0)[..., None]
            image = paper / np.maximum(usual, 0.05) * light
    elif style.ground == "checkers":
        assert isinstance(surface, EllipsoidalBowl)
        step = np.array([-0.25, 0.25]) / camera.pixels_per_metre
        share = np.zeros(x.shape)
        for dx in step:
            for dy in step:
                polar, azimuth = surface.angles(x + dx, y + dy)
                side = style.fields_rad
                fields = np.floor(np.nan_to_num(polar) / side) + np.floor(
                    np.nan_to_num(azimuth) / side
                )
                share += (fields % 2) / fine**2
        first, second, _ = np.asarray(appearance.ground.colors)
        image = (first + share[..., None] * (second - first)) * light
    else:
        image = paint_ground(appearance.ground) * light
    plain = np.random.default_rng(style.seed).random() < 0.4
    beyond = BEYOND_COLOR if plain else paint_ground(appearance.surroundings)
    return np.where(inside, image, beyond)


def render_restyled(
    renderer: Renderer, scene: Scene, trajectory: Trajectory, style: Restyling
) -> RestyledWindow:
    """Render the seen frames of a window in another appearance.

    Parameters
    ----------
    trajectory
        Of the seen frames alone.
    """
    appearance = style.appearance
    materials = _SceneMaterials(renderer, scene, style)
    frames = renderer.render_with(trajectory, materials)
    moving = [c for c in appearance.clutter if c.kind in ("hand", "cue", "shadow")]
    if moving:
        frames = np.stack([_with_clutter(f, moving, k) for k, f in enumerate(frames)])
    if appearance.camera != CameraPose():
        beyond = np.clip(255 * materials.ground[0, 0], 0, 255).astype(np.uint8)
        border = "mirrored" if scene.axis_ratio is None else "plain"
        frames = posed_frames(frames, appearance.camera, beyond, border)
    shake = np.asarray(appearance.sensor.shake)
    frames = through_sensor(shaken(frames, shake), appearance.sensor)
    return RestyledWindow(frames, appearance.camera, shake)


def _with_clutter(frame: np.ndarray, things: list[Clutter], index: int) -> np.ndarray:
    image = frame.astype(np.float32) / 255
    for thing in things:
        paint_clutter(image, thing, clutter_mask(thing, index))
    return np.clip(255 * image + 0.5, 0, 255).astype(np.uint8)
