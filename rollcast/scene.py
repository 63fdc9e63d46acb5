"""One immutable scene: everything that simulator, renderer and dataset need to agree on."""

import math
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, model_validator

Scenario: TypeAlias = Literal["hemisphere", "ellipsoid", "heightfield"]
SCENARIOS: tuple[Scenario, ...] = ("hemisphere", "ellipsoid", "heightfield")

Color: TypeAlias = Literal["red", "green", "blue"]
COLORS: tuple[Color, ...] = ("red", "green", "blue")
"""Balls are ordered by colour: object k always has colour ``COLORS[k]``."""

MAX_OBJECTS = len(COLORS)
MAX_FORECAST_OBJECTS = 4
"""Of a forecast: footage of a user's own set-up may show one more than scenes."""

MAX_BALLS = 8
"""Of a forecast by a model for any number of balls."""

Domain: TypeAlias = Literal["hemisphere", "ellipsoid", "heightfield", "footage"]
"""What a model knows: a simulated scenario, or footage of somebody's own set-up."""

BallColor: TypeAlias = Color | Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")]
"""Of a ball in footage: its mean colour there. All are colours of CSS."""

MAX_SEED = 2**53 - 1
"""Largest seed: every seed survives JSON, whose numbers are doubles."""

LARGE_RADIUS_M = 0.225
SMALL_RADIUS_M = 0.04

Vector3: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

MAX_SPEED_M_S = 15.0
"""Of each component of a start velocity; faster balls could pass a hill between two steps."""

Metres: TypeAlias = Annotated[float, Field(ge=-5, le=5)]
Speed: TypeAlias = Annotated[float, Field(ge=-MAX_SPEED_M_S, le=MAX_SPEED_M_S)]
Unit: TypeAlias = Annotated[float, Field(ge=-1, le=1)]


class Scene(BaseModel):
    """A sampled scene (paper, section "Experimental Setup"). Lengths in metres, world axes.

    Fields that do not belong to the scenario are None: the shape of a bowl is ``axis_ratio``, that
    of a heightfield ``noise_scale`` and ``noise_offset_m``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scenario: Scenario
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)]
    textured: bool
    """Several-coloured texture on the ball; otherwise white (one ball) or plain colours."""
    radius_m: Annotated[float, Field(ge=0.03, le=0.25)]
    """Radius of every ball."""
    rotation_rad: Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]
    """Rotation of the surface about the world's z axis."""
    axis_ratio: Annotated[float, Field(ge=0.4, le=1.0)] | None = None
    """Bowls: semi-axis along the bowl's own x; the other two are 1. Drawn from 0.5 on: the largest
    ball that can touch the bottom of a bowl has the radius of the ratio's square."""
    noise_scale: Annotated[float, Field(ge=0.2, le=0.7)] | None = None
    """Heightfields: side of a cell of the Perlin lattice, metres."""
    noise_offset_m: tuple[Metres, Metres] | None = None
    """Heightfields: the point of the noise plane that lies under the camera."""
    light_position_m: tuple[Metres, Metres, Annotated[float, Field(ge=1, le=5)]] | None = None
    """Heightfields: centre of the area light."""
    positions_m: tuple[tuple[Metres, Metres, Metres], ...]
    """Start of each ball's centre."""
    velocities_m_s: tuple[tuple[Speed, Speed, Speed], ...]
    orientations_xyzw: tuple[tuple[Unit, Unit, Unit, Unit], ...]

    @property
    def objects(self) -> int:
        """Number of balls."""
        return len(self.positions_m)

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scene":
        if not 1 <= self.objects <= MAX_OBJECTS:
            raise ValueError(
                f"positions_m has {self.objects} balls; 1 to {MAX_OBJECTS} are allowed"
            )
        for name in ("velocities_m_s", "orientations_xyzw"):
            count = len(getattr(self, name))
            if count != self.objects:
                raise ValueError(f"{name} has {count} entries for {self.objects} balls")
        for orientation in self.orientations_xyzw:
            if abs(math.hypot(*orientation) - 1) > 1e-3:
                raise ValueError(
                    f"orientations_xyzw has {orientation}, which is no unit quaternion"
                )
        if self.textured and self.objects > 1:
            raise ValueError("textured must be false with several balls: they are told by colour")
        bowl = {"axis_ratio"}
        heightfield = {"noise_scale", "noise_offset_m", "light_position_m"}
        wanted = heightfield if self.scenario == "heightfield" else bowl
        for name in sorted(bowl | heightfield):
            if (getattr(self, name) is not None) != (name in wanted):
                verb = "needs" if name in wanted else "has no"
                raise ValueError(f"scenario {self.scenario!r} {verb} {name}")
        if self.scenario == "hemisphere" and self.axis_ratio != 1.0:
            raise ValueError(f"axis_ratio of a hemisphere is 1, not {self.axis_ratio}")
        return self
