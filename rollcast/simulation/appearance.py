"""Appearance of a window: balls, ground, light, clutter, camera and sensor.

An :class:`Appearance` complements a :class:`rollcast.scene.Scene`, which describes the motion.
Trajectories are expensive and reused; appearances are cheap and drawn anew for every training
window. All randomness comes from the generator that is passed in; fine details (grain, texts,
positions of spots) follow from the seeds in the appearance.

Colours are RGB in 0..1, lengths are pixels of a 128-px frame unless a name says otherwise.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

RGB: TypeAlias = tuple[float, float, float]

BallPattern: TypeAlias = Literal[
    "plain", "two-tone", "striped", "octants", "numbered", "spots", "metallic", "glass", "disc"
]
BALL_PATTERNS: tuple[BallPattern, ...] = get_args(BallPattern)
"""Kind of ball: ``disc`` is a flat puck; metal and glass reflect and refract their surroundings."""

GroundPattern: TypeAlias = Literal[
    "plain", "cloth", "wood", "paper", "checkers", "stripes", "lines", "gradient", "marble",
    "shapes", "rings", "text",
]  # fmt: skip
GROUND_PATTERNS: tuple[GroundPattern, ...] = get_args(GroundPattern)

ClutterKind: TypeAlias = Literal["rectangle", "pocket", "hand", "cue", "shadow", "text"]
CLUTTER_KINDS: tuple[ClutterKind, ...] = get_args(ClutterKind)

Codec: TypeAlias = Literal["none", "jpeg", "video"]

_FELT: tuple[RGB, ...] = (
    (0.05, 0.35, 0.15), (0.10, 0.45, 0.30), (0.10, 0.25, 0.50), (0.45, 0.08, 0.10),
)  # fmt: skip
_WOOD: tuple[RGB, ...] = ((0.55, 0.38, 0.22), (0.75, 0.60, 0.42), (0.33, 0.20, 0.12))


@dataclass(frozen=True)
class BallAppearance:
    """Surface of one ball."""

    pattern: BallPattern
    colors: tuple[RGB, RGB, RGB]
    """Main colour, second one, and that of a number's field."""
    gloss: float
    """Strength of the lamp's highlight, 0..1."""
    shininess: float
    """Phong exponent of the highlight."""
    seed: int
    """Seed of axes, spots and digits."""


@dataclass(frozen=True)
class GroundAppearance:
    """Colours of the ground, before light falls on it."""

    pattern: GroundPattern
    colors: tuple[RGB, RGB, RGB]
    scale: float
    """Size of the pattern's parts."""
    angle_rad: float
    grain: float
    """Standard deviation of fine texture, 0..1."""
    seed: int


@dataclass(frozen=True)
class Lamp:
    """Light on balls and ground."""

    direction: tuple[float, float, float]
    """Unit vector towards the lamp, image axes: x right, y down, z towards the camera."""
    ambient: float
    """Share of the light that comes from everywhere, 0..1."""
    falloff: float
    """Share by which the ground is darker at the far end of the frame."""
    shadow: float
    """Darkening of the ground behind a ball, 0..1."""
    shadow_offset: float
    """Offset of the shadow from the ball, in ball radii."""
    shadow_softness: float
    """Width of a shadow's edge, ball radii."""


@dataclass(frozen=True)
class Clutter:
    """Something else in the frame, which rests or moves by itself."""

    kind: ClutterKind
    color: RGB
    at: tuple[float, float]
    """Position of the middle, or of the tip of a hand or cue."""
    size: float
    angle_rad: float
    velocity: tuple[float, float]
    """A frame."""
    seed: int


@dataclass(frozen=True)
class CameraPose:
    """Pose of the camera relative to the paper's."""

    scale: float = 1.0
    """Larger is nearer."""
    offset: tuple[float, float] = (0.0, 0.0)
    rotation_rad: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    """Perspective: relative change of scale from the centre to the edge, along x and y."""
    distortion: float = 0.0
    """Radial lens distortion: relative shift of a point at the middle of an edge."""

    @property
    def is_similarity(self) -> bool:
        """Return whether the view only scales, rotates and shifts."""
        return self.tilt == (0.0, 0.0) and self.distortion == 0.0


@dataclass(frozen=True)
class Sensor:
    """Effects of camera and file format on the picture."""

    gains: RGB = (1.0, 1.0, 1.0)
    """Exposure and white balance."""
    offset: float = 0.0
    """Offset on intensities 0..1."""
    gamma: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue_rad: float = 0.0
    vignette: float = 0.0
    """Darkening of the corners, 0..1."""
    reflection: float = 0.0
    """Strength of a soft bright spot, 0..1."""
    reflection_at: tuple[float, float] = (64.0, 64.0)
    flicker: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Relative exposure of the four frames."""
    shake: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 4
    """Shift of the picture in the four frames; none in the last, which is the reference."""
    shutter: float = 0.0
    """Share of a frame's time that it is exposed."""
    blur: float = 0.0
    """Standard deviation of the lens's blur."""
    sharpening: float = 0.0
    noise: float = 0.0
    """Standard deviation, levels of 255."""
    noise_cell: int = 1
    """Side of the noise's cells in pixels."""
    codec: Codec = "none"
    quality: int = 90
    """JPEG's, 1 to 100."""
    seed: int = 0
    """Seed of the noise."""


@dataclass(frozen=True)
class Appearance:
    """The appearance of one window."""

    ball: BallAppearance
    """Appearance of the prompted ball."""
    ground: GroundAppearance
    surroundings: GroundAppearance
    """Surroundings beyond the rim or table."""
    lamp: Lamp
    clutter: tuple[Clutter, ...]
    camera: CameraPose
    sensor: Sensor


def draw_appearance(generator: np.random.Generator, *, strength: float = 1.0) -> Appearance:
    """Draw the appearance of one window.

    Parameters
    ----------
    strength
        Scales how probable and how large the effects of camera and sensor are, 0..1.
    """
    ground = draw_ground(generator)
    return Appearance(
        ball=draw_ball(generator, apart_from=mean_color(ground)),
        ground=ground,
        surroundings=draw_ground(generator),
        lamp=_draw_lamp(generator),
        clutter=_draw_clutter(generator),
        camera=draw_camera(generator, strength),
        sensor=draw_sensor(generator, strength),
    )


def draw_color(generator: np.random.Generator) -> RGB:
    """Draw a colour: any, saturated, grey, or one that grounds often have."""
    kind = generator.random()
    if kind < 0.35:
        red, green, blue = generator.random(3).tolist()
        return red, green, blue
    if kind < 0.65:
        return _from_hsv(generator.random(), generator.uniform(0.5, 1), generator.uniform(0.3, 1))
    if kind < 0.88:
        grey = generator.random()
        red, green, blue = np.clip(grey + generator.normal(0, 0.02, 3), 0, 1).tolist()
        return red, green, blue
    known = (*_FELT, *_WOOD)
    base = np.array(known[generator.integers(len(known))])
    red, green, blue = np.clip(base * generator.uniform(0.7, 1.4), 0, 1).tolist()
    return red, green, blue


def mean_color(appearance: GroundAppearance) -> RGB:
    """Return the mean colour of a ground."""
    one = np.asarray(appearance.colors[0])
    if appearance.pattern in (
        "checkers",
        "stripes",
        "gradient",
        "marble",
        "shapes",
        "rings",
        "wood",
    ):
        one = (one + np.asarray(appearance.colors[1])) / 2
    red, green, blue = one.tolist()
    return red, green, blue


def draw_ball(
    generator: np.random.Generator, apart_from: RGB = (0.5, 0.5, 0.5), contrast: float = 0.18
) -> BallAppearance:
    """Sample a ball whose colour differs from the given one, so that it is visible."""
    weights = np.array([5, 1.5, 1.5, 1.5, 1.5, 1.0, 0.8, 0.5, 1.0])
    pattern = BALL_PATTERNS[generator.choice(len(BALL_PATTERNS), p=weights / weights.sum())]
    color = _draw_ball_color(generator)
    for _ in range(8):
        if math.dist(color, apart_from) > contrast:
            break
        color = _draw_ball_color(generator)
    return BallAppearance(
        pattern,
        (color, _draw_ball_color(generator), (0.95, 0.95, 0.92)),
        gloss=float(generator.choice([0.0, generator.uniform(0, 1)])),
        shininess=float(generator.uniform(8, 60)),
        seed=_seed(generator),
    )


def _draw_ball_color(generator: np.random.Generator) -> RGB:
    kind = generator.random()
    if kind < 0.2:
        white = generator.uniform(0.8, 1)
        return white, white * generator.uniform(0.93, 1), white * generator.uniform(0.85, 1)
    if kind < 0.28:
        black = generator.uniform(0, 0.15)
        return black, black, black
    return draw_color(generator)


def draw_ground(generator: np.random.Generator) -> GroundAppearance:
    """Sample a ground or its surroundings."""
    weights = np.array([3, 2, 1.5, 1, 1.5, 1, 1, 1, 1.5, 1.5, 0.7, 0.7])
    pattern = GROUND_PATTERNS[generator.choice(len(GROUND_PATTERNS), p=weights / weights.sum())]
    colors = [draw_color(generator) for _ in range(3)]
    if generator.random() < 0.5:  # shades of one colour are commoner than a motley
        base = np.asarray(colors[0])
        colors[1:] = [_near(generator, base) for _ in range(2)]
    return GroundAppearance(
        pattern,
        (colors[0], colors[1], colors[2]),
        scale=math.exp(generator.uniform(math.log(3), math.log(48))),
        angle_rad=generator.uniform(-math.pi, math.pi),
        grain=float(generator.choice([0.0, generator.uniform(0, 0.06)])),
        seed=_seed(generator),
    )


def _near(generator: np.random.Generator, base: np.ndarray) -> RGB:
    red, green, blue = np.clip(base + generator.normal(0, 0.12), 0, 1).tolist()
    return red, green, blue


def _draw_lamp(generator: np.random.Generator) -> Lamp:
    azimuth, height = generator.uniform(-math.pi, math.pi), generator.uniform(0.25, 1)
    flat = math.sqrt(1 - height**2)
    return Lamp(
        (flat * math.cos(azimuth), flat * math.sin(azimuth), height),
        ambient=generator.uniform(0.2, 1),
        falloff=float(generator.choice([0.0, generator.uniform(0, 0.6)])),
        shadow=float(generator.choice([0.0, generator.uniform(0.1, 0.8)])),
        shadow_offset=generator.uniform(0, 1.2),
        shadow_softness=generator.uniform(0.05, 0.8),
    )


def _draw_clutter(generator: np.random.Generator) -> tuple[Clutter, ...]:
    count = int(generator.choice([0, 1, 2, 3, 5], p=[0.4, 0.25, 0.15, 0.1, 0.1]))
    return tuple(_draw_one_clutter(generator) for _ in range(count))


def _draw_one_clutter(generator: np.random.Generator) -> Clutter:
    weights = np.array([3, 1, 1.5, 1.2, 1, 1])
    kind = CLUTTER_KINDS[generator.choice(len(CLUTTER_KINDS), p=weights / weights.sum())]
    moves = kind in ("hand", "cue", "shadow") and generator.random() < 0.6
    velocity = generator.normal(0, 1.5, 2) if moves else np.zeros(2)
    x, y = generator.uniform(0, 128, 2).tolist()
    color = draw_color(generator)
    if kind == "pocket":
        color = (0.04, 0.04, 0.04)
    if kind == "hand" and generator.random() < 0.7:
        tone = generator.uniform(0.25, 1)
        color = (0.95 * tone, 0.72 * tone, 0.58 * tone)
    return Clutter(
        kind, color, (x, y),
        size=math.exp(generator.uniform(math.log(3), math.log(40))),
        angle_rad=generator.uniform(-math.pi, math.pi),
        velocity=(float(velocity[0]), float(velocity[1])),
        seed=_seed(generator),
    )  # fmt: skip


def draw_camera(generator: np.random.Generator, strength: float = 1.0) -> CameraPose:
    """Sample a pose of the camera; it is the paper's in two of five windows or more."""
    if generator.random() > 0.6 * strength:
        return CameraPose()
    similar = generator.random() < 0.6
    tilt = (0.0, 0.0) if similar else generator.uniform(-0.15, 0.15, 2)
    return CameraPose(
        scale=math.exp(generator.uniform(-0.4, 0.3)),
        offset=(generator.uniform(-8, 8), generator.uniform(-8, 8)),
        rotation_rad=generator.uniform(-math.pi, math.pi),
        tilt=(float(tilt[0]), float(tilt[1])),
        distortion=0.0 if similar else generator.uniform(-0.12, 0.12),
    )


def draw_sensor(generator: np.random.Generator, strength: float = 1.0) -> Sensor:
    """Sample effects of camera and file format; each effect is absent in most windows."""

    def happens(probability: float) -> bool:
        return bool(generator.random() < probability * strength)

    def around_one(spread: float) -> float:
        return math.exp(generator.uniform(-spread, spread))

    exposure = around_one(0.5) if happens(0.4) else 1.0
    balance = [around_one(0.35) if happens(1.0) else 1.0 for _ in range(3)]
    if not happens(0.4):
        balance = [1.0] * 3
    flicker = [around_one(0.08) for _ in range(4)] if happens(0.12) else [1.0] * 4
    size = generator.uniform(0.1, 1.2)
    shake = generator.normal(0, size, (3, 2)) if happens(0.25) else np.zeros((3, 2))
    saturation = generator.uniform(0.3, 1.7) if happens(0.3) else 1.0
    if happens(0.1):
        saturation = 0.0
    codec: Codec = "none"
    if happens(0.45):
        codec = "jpeg" if generator.random() < 0.65 else "video"
    return Sensor(
        gains=(exposure * balance[0], exposure * balance[1], exposure * balance[2]),
        offset=generator.uniform(-0.12, 0.2) if happens(0.2) else 0.0,
        gamma=around_one(0.6) if happens(0.35) else 1.0,
        contrast=generator.uniform(0.4, 1.4) if happens(0.3) else 1.0,
        saturation=saturation,
        hue_rad=generator.uniform(-math.pi, math.pi) if happens(0.12) else 0.0,
        vignette=generator.uniform(0.1, 0.6) if happens(0.2) else 0.0,
        reflection=generator.uniform(0.1, 0.6) if happens(0.12) else 0.0,
        reflection_at=(generator.uniform(0, 128), generator.uniform(0, 128)),
        flicker=(flicker[0], flicker[1], flicker[2], flicker[3]),
        shake=(*((float(x), float(y)) for x, y in shake), (0.0, 0.0)),
        shutter=generator.uniform(0.1, 0.9) if happens(0.35) else 0.0,
        blur=generator.uniform(0.3, 1.6) if happens(0.3) else 0.0,
        sharpening=generator.uniform(0.2, 1.2) if happens(0.12) else 0.0,
        noise=abs(generator.normal(0, 7)) if happens(0.5) else 0.0,
        noise_cell=int(generator.choice([1, 1, 2])),
        codec=codec,
        quality=int(generator.integers(15, 95)),
        seed=_seed(generator),
    )


def _from_hsv(hue: float, saturation: float, value: float) -> RGB:
    """Colour of hue, saturation and value in 0..1."""
    red, green, blue = (
        value * (1 - saturation * (1 - min(max(abs((6 * hue + shift) % 6 - 3) - 1, 0), 1)))
        for shift in (0, 4, 2)
    )
    return red, green, blue


def _seed(generator: np.random.Generator) -> int:
    return int(generator.integers(2**31))
