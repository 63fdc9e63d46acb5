"""One immutable scene: everything that simulator, renderer and dataset need to agree on."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, Strict, create_model, model_validator
from pydantic.fields import FieldInfo

Scenario: TypeAlias = Literal["hemisphere", "ellipsoid", "heightfield", "table"]
SCENARIOS: tuple[Scenario, ...] = get_args(Scenario)
"""New scenarios are appended: a seed's generator depends on the index."""

Color: TypeAlias = Literal["red", "green", "blue", "yellow", "magenta", "cyan", "orange", "white"]
PALETTE: Mapping[Color, tuple[float, float, float]] = {
    "red": (0.9, 0.1, 0.1),
    "green": (0.1, 0.8, 0.1),
    "blue": (0.15, 0.25, 0.95),
    "yellow": (0.95, 0.85, 0.1),
    "magenta": (0.85, 0.15, 0.75),
    "cyan": (0.1, 0.8, 0.85),
    "orange": (0.95, 0.5, 0.1),
    "white": (0.95, 0.95, 0.95),
}
"""Colours of several balls by their CSS name: linear red, green and blue in 0..1. The only place
to add one."""
COLORS: tuple[Color, ...] = tuple(PALETTE)
"""Balls are ordered by colour: object k always has colour ``COLORS[k]``."""

MAX_OBJECTS = len(COLORS)
MAX_FORECAST_OBJECTS = 4
"""Maximum number of balls of models for footage: one more than in scenes."""

MAX_BALLS = 8
"""Balls of a forecast by a model for any number of balls."""

Domain: TypeAlias = Literal["hemisphere", "ellipsoid", "heightfield", "table", "footage"]
"""Domain of a model: a simulated scenario, or footage of a user's own set-up."""

BallColor: TypeAlias = Color | Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")]
"""Color of a ball as in CSS; for footage the mean colour of the ball."""

MAX_SEED = 2**53 - 1
"""Largest seed: every seed survives JSON, whose numbers are doubles."""

LARGE_RADIUS_M = 0.225
SMALL_RADIUS_M = 0.04

Vector3: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

MAX_SPEED_M_S = 30.0
"""Limit of each component of a start velocity: twice the fastest of the paper."""
MAX_HEIGHTFIELD_SPEED_M_S = 15.0
"""Limit on heightfields, where a faster ball could pass a hill between two steps."""
MAX_SPIN_RAD_S = 500.0
MAX_SLOPE = 0.2
"""Limit of a table's rise per metre along each axis."""

Number: TypeAlias = Annotated[float, Strict()]
"""A number that is not text."""
Metres: TypeAlias = Annotated[Number, Field(ge=-5, le=5)]
Speed: TypeAlias = Annotated[Number, Field(ge=-MAX_SPEED_M_S, le=MAX_SPEED_M_S)]
Unit: TypeAlias = Annotated[Number, Field(ge=-1, le=1)]
Spin: TypeAlias = Annotated[Number, Field(ge=-MAX_SPIN_RAD_S, le=MAX_SPIN_RAD_S)]
Slope: TypeAlias = Annotated[Number, Field(ge=-MAX_SLOPE, le=MAX_SLOPE)]
Friction: TypeAlias = Annotated[Number, Field(ge=0.01, le=1)]
Restitution: TypeAlias = Annotated[Number, Field(ge=0.1, le=1)]
ItemT = TypeVar("ItemT")
PerBall: TypeAlias = Annotated[tuple[ItemT, ...], Field(max_length=MAX_OBJECTS, fail_fast=True)]
"""A value of every ball."""


class Scene(BaseModel):
    """A sampled scene (paper, section "Experimental Setup"). Lengths in metres, world axes.

    Fields that do not belong to the scenario are None: the shape of a bowl is ``axis_ratio``, that
    of a heightfield ``noise_scale`` and ``noise_offset_m``, that of a table ``slope`` and
    ``walls_m``. A material property that is None has the value of the paper's scenes
    (``rollcast.simulation.physics.Material``).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scenario: Scenario
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)]
    textured: Annotated[bool, Strict()]
    """Texture of several colours; without it balls are white (one ball) or have plain colours."""
    radius_m: Annotated[Number, Field(ge=0.03, le=0.25)]
    """Radius of every ball."""
    rotation_rad: Annotated[Number, Field(ge=-2 * math.pi, le=2 * math.pi)]
    """Rotation of the surface about the world's z axis."""
    axis_ratio: Annotated[Number, Field(ge=0.4, le=1.0)] | None = None
    """Bowls: semi-axis along the bowl's own x; the other two are 1. Drawn from 0.5 on: the largest
    ball that can touch the bottom of a bowl has the radius of the ratio's square."""
    noise_scale: Annotated[Number, Field(ge=0.2, le=0.7)] | None = None
    """Heightfields: side of a cell of the Perlin lattice, metres."""
    noise_offset_m: tuple[Metres, Metres] | None = None
    """Heightfields: the point of the noise plane that lies under the camera."""
    light_position_m: tuple[Metres, Metres, Annotated[Number, Field(ge=1, le=5)]] | None = None
    """Heightfields: centre of the area light."""
    slope: tuple[Slope, Slope] | None = None
    """Tables: rise per metre along the world's x and y."""
    walls_m: tuple[Metres, Metres, Metres, Metres] | None = None
    """Tables: cushions at (left, bottom, right, top), world x and y; open tables have them far out
    of view."""
    friction: Friction | None = None
    """Coulomb coefficient between balls and ground."""
    ball_friction: Friction | None = None
    """Coulomb coefficient between two balls."""
    wall_friction: Annotated[Number, Field(ge=0, le=1)] | None = None
    """Coulomb coefficient between balls and walls."""
    rolling_resistance: Annotated[Number, Field(ge=0, le=0.3)] | None = None
    """Resisting torque per normal force, in ball radii."""
    damping: Annotated[Number, Field(ge=0, le=1)] | None = None
    """Air drag d: ``dv/dt = -d v (1 + |v|)``, in m/s, and likewise for the spin in rad/s."""
    ball_restitution: Restitution | None = None
    """Coefficient of restitution between two balls."""
    wall_restitution: Restitution | None = None
    """Coefficient of restitution between a ball and a wall."""
    mass_ratios: PerBall[Annotated[Number, Field(ge=0.1, le=10)]] | None = None
    """Mass of each ball relative to the others; None makes all equal."""
    spins_rad_s: PerBall[tuple[Spin, Spin, Spin]] | None = None
    """Angular velocity of each ball at the start, world axes; None starts without spin."""
    positions_m: Annotated[PerBall[tuple[Metres, Metres, Metres]], Field(min_length=1)]
    """Start of each ball's centre."""
    velocities_m_s: PerBall[tuple[Speed, Speed, Speed]]
    orientations_xyzw: PerBall[tuple[Unit, Unit, Unit, Unit]]

    @property
    def objects(self) -> int:
        """Number of balls."""
        return len(self.positions_m)

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scene":
        for name in ("velocities_m_s", "orientations_xyzw", "mass_ratios", "spins_rad_s"):
            entries = getattr(self, name)
            if entries is not None and len(entries) != self.objects:
                raise ValueError(f"{name} has {len(entries)} entries for {self.objects} balls")
        for orientation in self.orientations_xyzw:
            if abs(math.hypot(*orientation) - 1) > 1e-3:
                raise ValueError(
                    f"orientations_xyzw has {orientation}, which is no unit quaternion"
                )
        if self.textured and self.objects > 1:
            raise ValueError("textured must be false with several balls: they are told by colour")
        wanted = _SHAPE_FIELDS[self.scenario]
        for name in sorted({name for names in _SHAPE_FIELDS.values() for name in names}):
            if (getattr(self, name) is not None) != (name in wanted):
                verb = "needs" if name in wanted else "has no"
                raise ValueError(f"scenario {self.scenario!r} {verb} {name}")
        if self.scenario == "hemisphere" and self.axis_ratio != 1.0:
            raise ValueError(f"axis_ratio of a hemisphere is 1, not {self.axis_ratio}")
        if self.scenario == "heightfield":
            fastest = max(abs(part) for velocity in self.velocities_m_s for part in velocity)
            if fastest > MAX_HEIGHTFIELD_SPEED_M_S:
                raise ValueError(
                    f"velocities_m_s has {fastest}; a heightfield takes at most "
                    f"{MAX_HEIGHTFIELD_SPEED_M_S} m/s along each axis"
                )
        if self.walls_m is not None:
            left, bottom, right, top = self.walls_m
            if min(right - left, top - bottom) <= 2 * self.radius_m:
                raise ValueError(
                    f"walls_m is {self.walls_m}; left, bottom, right, top must leave room for a "
                    "ball"
                )
        return self


_SHAPE_FIELDS: Mapping[Scenario, tuple[str, ...]] = {
    "hemisphere": ("axis_ratio",),
    "ellipsoid": ("axis_ratio",),
    "heightfield": ("noise_scale", "noise_offset_m", "light_position_m"),
    "table": ("slope", "walls_m"),
}
"""Fields that a scenario needs."""


def _optional(field: FieldInfo) -> tuple[Any, None]:
    """Return the definition of a field that takes the same values, or None, its default."""
    kind: Any = Annotated[field.annotation, field]
    return kind | None if field.is_required() else kind, None


_fields: dict[str, Any] = {name: _optional(field) for name, field in Scene.model_fields.items()}
_AnyFields = create_model("_AnyFields", __module__=__name__, **_fields)


class SceneParameters(_AnyFields):
    """Any fields of a :class:`Scene`; those left out or None are sampled."""

    model_config = Scene.model_config

    def given(self) -> dict[str, Any]:
        """Return the parameters that are not None, by name."""
        return self.model_dump(exclude_none=True)
