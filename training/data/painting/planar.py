"""Planar scenes: balls that move freely over a plane, to teach seeing alone.

Only positions in the four observed frames are known. Ground, heights and later positions are
unknown: these parts of the truth are NaN and have no loss.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from rollcast.simulation.appearance import (
    Appearance,
    BallAppearance,
    Clutter,
    draw_appearance,
    draw_ball,
    mean_color,
)
from rollcast.trajectory import OBSERVED_FRAMES
from training.data.painting.balls import (
    BallPainter,
    cast_soft_shadow,
    paint_ball,
    random_rotation,
    rotation_about,
)
from training.data.painting.camera import shaken
from training.data.painting.clutter import clutter_mask, paint_clutter
from training.data.painting.ground import SIZE, paint_ground
from training.data.painting.sensor import through_sensor

SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 1.3, 30.0
FASTEST_PX = 14.0
"""A frame."""

MOST_BALLS = 8
HIDDEN = 0.1
"""Largest share of the meant ball that clutter may cover in any frame."""

_TRIES = 30


@dataclass(frozen=True)
class PlanarBall:
    """A ball of a planar scene."""

    appearance: BallAppearance
    radius: float
    """Radius in pixels."""
    path: tuple[tuple[float, float], ...]
    """Places in the seen frames, pixels."""
    rolls: bool
    """Rotation of the texture with the motion."""

    @property
    def moves(self) -> bool:
        """Whether it is in different places."""
        return self.path[0] != self.path[-1]


@dataclass(frozen=True)
class PlanarScene:
    """Content of one planar window. The first ball is the prompted one."""

    appearance: Appearance
    balls: tuple[PlanarBall, ...]
    seed: int
    """Seed of orientations."""


class PlanarWindow(NamedTuple):
    """Frames with the places of the meant ball."""

    frames: UInt8[np.ndarray, "frames size size 3"]
    path: Float[np.ndarray, "frames 2"]
    """Positions without the camera's shake."""
    shake: Float[np.ndarray, "frames 2"]
    """Shift of the picture, none in the last frame."""


def draw_planar_scene(generator: np.random.Generator, *, prompted: bool) -> PlanarScene:
    """Draw a planar scene.

    Parameters
    ----------
    prompted
        Whether a prompt says which ball is meant. Any may move then, or none; without a prompt
        the meant ball is the one that moves, or the only one.
    """
    appearance = draw_appearance(generator)
    count = int(generator.choice([1, 2, 3, 5, MOST_BALLS], p=[0.3, 0.2, 0.2, 0.15, 0.15]))
    radius = _draw_radius(generator)
    rests = generator.random() < (0.25 if prompted else 0.25 * (count == 1))
    meant = PlanarBall(
        appearance.ball,
        radius,
        _draw_path(generator, radius, rests=rests),
        generator.random() < 0.7,
    )
    balls = [meant]
    alike = generator.random() < 0.4
    for _ in range(count - 1):
        other = _draw_other(generator, appearance, balls, alike=alike, moving=prompted)
        if other is not None:
            balls.append(other)
    return PlanarScene(appearance, tuple(balls), int(generator.integers(2**31)))


def _draw_radius(generator: np.random.Generator) -> float:
    low, high = math.log(SMALLEST_RADIUS_PX), math.log(LARGEST_RADIUS_PX)
    # Small balls are the commoner ones in other people's pictures, and the harder ones.
    return math.exp(low + (high - low) * generator.beta(1.0, 1.5))


def _draw_path(
    generator: np.random.Generator, radius: float, *, rests: bool
) -> tuple[tuple[float, float], ...]:
    """Draw a straight, slowing, curving or bouncing way that stays in the frame."""
    for _ in range(_TRIES):
        if generator.random() < 0.5:
            speed = math.exp(generator.uniform(math.log(0.05), math.log(FASTEST_PX)))
        else:
            speed = generator.uniform(0.3, 6)
        heading = generator.uniform(-math.pi, math.pi)
        velocity = 0.0 if rests else speed
        step = velocity * np.array([math.cos(heading), math.sin(heading)])
        steps = np.stack([step] * (OBSERVED_FRAMES - 1))
        kind = generator.random()
        if kind < 0.25:
            steps *= generator.uniform(0.6, 1.3) ** np.arange(OBSERVED_FRAMES - 1)[:, None]
        elif kind < 0.4:
            steps = _turned(steps, generator.uniform(-0.5, 0.5))
        elif kind < 0.5:
            steps[generator.integers(1, OBSERVED_FRAMES - 1) :] *= _bounce(generator)
        last = generator.uniform(-0.2 * radius, SIZE + 0.2 * radius, 2)
        path = last - np.concatenate([np.cumsum(steps[::-1], axis=0)[::-1], np.zeros((1, 2))])
        margin = min(0.3 * radius, 2)
        if path.min() > margin and path.max() < SIZE - margin:
            break
    else:
        path = np.full((OBSERVED_FRAMES, 2), SIZE / 2) + generator.uniform(-40, 40, 2)
    return tuple((float(x), float(y)) for x, y in path)


def _turned(steps: np.ndarray, angle_rad: float) -> np.ndarray:
    angles = angle_rad * np.arange(len(steps))
    cos, sin = np.cos(angles), np.sin(angles)
    x, y = steps.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def _bounce(generator: np.random.Generator) -> np.ndarray:
    signs = np.array([1.0, 1.0])
    signs[generator.integers(2)] = -1
    return signs * generator.uniform(0.5, 1)


def _draw_other(
    generator: np.random.Generator,
    appearance: Appearance,
    balls: list[PlanarBall],
    *,
    alike: bool,
    moving: bool,
) -> PlanarBall | None:
    """Draw a ball that overlaps none of the others in any frame; None when there is no room."""
    meant = balls[0]
    ball_appearance = meant.appearance
    if not alike or generator.random() < 0.3:
        ball_appearance = draw_ball(generator, apart_from=mean_color(appearance.ground))
    radius = meant.radius * float(generator.choice([1.0, 1.0, generator.uniform(0.5, 2)]))
    radius = min(max(radius, SMALLEST_RADIUS_PX), LARGEST_RADIUS_PX)
    for _ in range(_TRIES):
        rests = not moving or generator.random() < 0.5
        path = np.asarray(_draw_path(generator, radius, rests=rests))
        touching = generator.random() < 0.25
        if rests and touching:  # racks and pairs
            beside = balls[generator.integers(len(balls))]
            angle = generator.uniform(-math.pi, math.pi)
            apart = (beside.radius + radius) * np.array([math.cos(angle), math.sin(angle)])
            path = np.repeat(np.asarray(beside.path)[-1:] + 1.01 * apart, OBSERVED_FRAMES, axis=0)
        gaps = [
            np.linalg.norm(path - np.asarray(ball.path), axis=1).min() - ball.radius - radius
            for ball in balls
        ]
        if min(gaps) > 0:
            places = tuple((float(x), float(y)) for x, y in path)
            return PlanarBall(ball_appearance, radius, places, generator.random() < 0.7)
    return None


def paint_planar_scene(scene: PlanarScene) -> PlanarWindow:
    """Paint the four frames of a planar scene."""
    appearance = scene.appearance
    sensor, lamp = appearance.sensor, appearance.lamp
    generator = np.random.default_rng(scene.seed)
    empty = _lit_ground(appearance, generator)
    moving = _with_clutter(empty, scene)
    painters = [BallPainter(ball.appearance) for ball in scene.balls]
    turns = [random_rotation(generator) for _ in scene.balls]
    pairs = list(zip(scene.balls, painters, turns, strict=True))
    for ball in scene.balls:
        if not ball.moves:
            cast_soft_shadow(empty, np.asarray(ball.path[0]), ball.radius, lamp)
    for ball, painter, turn in pairs:
        if not ball.moves:
            paint_ball(empty, painter, np.asarray(ball.path[0]), ball.radius, turn, lamp)
    frames: list[np.ndarray] = []
    for frame in range(OBSERVED_FRAMES):
        image = empty.copy()
        for ball, painter, turn in pairs:
            if ball.moves:
                _paint_moving(image, ball, painter, turn, appearance, frame)
        for thing in moving:
            paint_clutter(image, thing, clutter_mask(thing, frame))
        frames.append(np.clip(255 * image + 0.5, 0, 255).astype(np.uint8))
    shake = np.asarray(sensor.shake)
    shown = through_sensor(shaken(np.stack(frames), shake), sensor)
    return PlanarWindow(shown, np.asarray(scene.balls[0].path), shake)


def _lit_ground(appearance: Appearance, generator: np.random.Generator) -> np.ndarray:
    image = paint_ground(appearance.ground)
    if generator.random() < 0.4:  # a table, plate or arena in front of something else
        outside = paint_ground(appearance.surroundings)
        share = _region(generator)[..., None]
        image = outside + share * (image - outside)
    lamp = appearance.lamp
    if lamp.falloff:
        along = (np.arange(SIZE, dtype=np.float32) + 0.5) / SIZE - 0.5
        x, y, _ = lamp.direction
        far = np.clip(0.5 - x * along[None, :] - y * along[:, None], 0, 1)
        image = image * (1 - lamp.falloff * far)[..., None]
    return image.astype(np.float32)


def _region(generator: np.random.Generator) -> Float[np.ndarray, "size size"]:
    """Draw the share of every pixel that is on the table: a disc or a turned rectangle."""
    along = np.arange(SIZE, dtype=np.float32) + 0.5 - SIZE / 2
    middle = generator.uniform(-12, 12, 2)
    x, y = along[None, :] - middle[0], along[:, None] - middle[1]
    if generator.random() < 0.4:
        return np.clip(generator.uniform(40, 66) - np.hypot(x, y) + 0.5, 0, 1)
    angle = generator.choice([0.0, generator.uniform(-0.3, 0.3)])
    cos, sin = math.cos(angle), math.sin(angle)
    half = generator.uniform(30, 64, 2)
    u, v = np.abs(cos * x + sin * y), np.abs(cos * y - sin * x)
    return np.clip(np.minimum(half[0] - u, half[1] - v) + 0.5, 0, 1)


def _with_clutter(empty: np.ndarray, scene: PlanarScene) -> list[Clutter]:
    """Paint resting clutter onto the ground; return moving clutter, painted over the balls."""
    over: list[Clutter] = []
    for thing in scene.appearance.clutter:
        if thing.kind in ("hand", "cue", "shadow"):
            if thing.kind == "shadow" or not _hides(thing, scene.balls[0]):
                over.append(thing)
        else:
            paint_clutter(empty, thing, clutter_mask(thing, OBSERVED_FRAMES - 1))
    return over


def _hides(thing: Clutter, ball: PlanarBall) -> bool:
    """Whether a thing covers more than a little of a ball in any frame."""
    along = np.arange(SIZE) + 0.5
    for frame, (x, y) in enumerate(ball.path):
        disc = np.hypot(along[None, :] - x, along[:, None] - y) <= ball.radius + 1
        if (clutter_mask(thing, frame) * disc).sum() > HIDDEN * disc.sum():
            return True
    return False


def _paint_moving(
    image: np.ndarray,
    ball: PlanarBall,
    painter: BallPainter,
    turn: np.ndarray,
    appearance: Appearance,
    frame: int,
) -> None:
    path = np.asarray(ball.path)
    step = path[min(frame + 1, len(path) - 1)] - path[max(frame - 1, 0)]
    step = step / (1 if frame in (0, len(path) - 1) else 2)
    if ball.rolls:
        gone = path[frame] - path[0]
        way = float(np.hypot(*gone))
        if way > 0:
            # Image axes with z towards the camera: a ball that goes right turns about +y (down).
            axis = np.array([-gone[1], gone[0], 0]) / way
            turn = rotation_about(axis, way / ball.radius) @ turn
    shutter = appearance.sensor.shutter
    cast_soft_shadow(image, path[frame], ball.radius, appearance.lamp)
    smear = shutter * step if shutter * float(np.hypot(*step)) > 0.3 else None
    paint_ball(image, painter, path[frame], ball.radius, turn, appearance.lamp, smear)
