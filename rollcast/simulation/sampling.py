"""Scene distributions of the paper's section "Experimental Setup", without its rejection rules.

Tables are an addition to the paper: planes with or without cushions, sliding balls, spin.

Every field is drawn whether or not the caller fixes it, so fixing one leaves the others' draws
unchanged. docs/decisions/0014 lists the choices that the paper leaves open.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from rollcast.camera import HEIGHTFIELD_HALF_WIDTH_M, TABLE_HALF_WIDTH_M
from rollcast.errors import SceneParametersError
from rollcast.scene import LARGE_RADIUS_M, SCENARIOS, Scenario, Scene, SceneParameters, Vector3
from rollcast.simulation.bullet import pybullet
from rollcast.surfaces import Contact, EllipsoidalBowl, Heightfield, Table

NOISE_PLANE_SIDE_M = 8.0
LIGHT_HEIGHT_M = 2.0
MAX_STARTS = 1000
"""Draws of one ball's start before the scene is taken as it is, for the whole to be judged."""
OUT_OF_VIEW_M = (-5.0, -5.0, 5.0, 5.0)
"""Walls of an open table."""
MAX_TABLE_STARTS = 100
"""Maximum draws on tables, where a start is acceptable unless balls overlap."""


WEDGED = 1.1
"""Ball radius from which no scene was found in 200 draws, relative to the radius of curvature at a
bowl's bottom: the square of the axis ratio."""


class Start(NamedTuple):
    """Start position and velocity of a ball."""

    position_m: Vector3
    velocity_m_s: Vector3
    spin_rad_s: Vector3 = (0.0, 0.0, 0.0)


def scene_generator(scenario: Scenario, objects: int, seed: int) -> np.random.Generator:
    """Return the one source of randomness of a seed: its scene and the redraws of it."""
    return np.random.default_rng([seed, SCENARIOS.index(scenario), objects])


def draw_scene(
    scenario: Scenario,
    objects: int,
    seed: int,
    generator: np.random.Generator,
    fixed: Mapping[str, object],
    acceptable: Callable[[Scene], bool],
) -> Scene:
    """Draw one candidate scene; ``fixed`` overrides fields of :class:`Scene` by name.

    Parameters
    ----------
    acceptable
        Whether the last ball of a scene may start as it does; with several balls each is drawn
        until it may. Without that, nearly every scene with three fast balls would be dropped.

    Raises
    ------
    SceneParametersError
        When a fixed field is unknown or does not fit the scene.
    """
    fields: dict[str, Any] = {
        "scenario": scenario,
        "seed": seed,
        "textured": objects == 1,
        "radius_m": LARGE_RADIUS_M,
        "rotation_rad": generator.uniform(-math.pi, math.pi),
    }
    chosen = _validated(fixed)
    for name in ("scenario", "seed"):
        if chosen.get(name, fields[name]) != fields[name]:
            raise SceneParametersError(name, chosen[name], f"{fields[name]!r} as in the call")
    fields |= chosen
    if scenario == "heightfield":
        fields |= _draw_landscape(generator) | chosen
        draw_start = _heightfield_starts(fields, generator)
    elif scenario == "table":
        fields |= draw_material(generator, objects) | _draw_table(generator) | chosen
        draw_start = _table_starts(fields, generator)
    else:
        fields |= _draw_bowl(scenario, generator) | chosen
        _require_room(fields)
        draw_start = _bowl_starts(fields, objects, generator)
    redraws = MAX_TABLE_STARTS if scenario == "table" else MAX_STARTS
    starts: list[Start] = []
    for _ in range(objects):
        starts.append(draw_start())
        for _ in range(redraws if objects > 1 else 0):
            if acceptable(_with_starts(fields, starts)):
                break
            starts[-1] = draw_start()
        else:
            if scenario == "table":
                redraws = 0  # no room: the scene as a whole is rejected soon enough
    fields["positions_m"] = [start.position_m for start in starts]
    fields["velocities_m_s"] = [start.velocity_m_s for start in starts]
    fields["orientations_xyzw"] = [_draw_orientation(generator) for _ in range(objects)]
    if scenario == "table":
        fields["spins_rad_s"] = [start.spin_rad_s for start in starts]
    fields |= chosen
    scene = _scene(fields)
    if scene.objects != objects:
        raise SceneParametersError("positions_m", scene.positions_m, f"{objects} positions")
    return scene


def _validated(fixed: Mapping[str, object]) -> dict[str, Any]:
    """Check fixed fields alone, before other draws depend on them. None leaves a field free."""
    try:
        return SceneParameters.model_validate(dict(fixed)).given()
    except ValidationError as error:
        first = error.errors()[0]
        path, expected = ".".join(map(str, first["loc"])), first["msg"]
        if first["type"] == "extra_forbidden":
            expected = f"one of the scene parameters {', '.join(Scene.model_fields)}"
        raise SceneParametersError(path, first["input"], expected) from error


def _with_starts(fields: Mapping[str, Any], starts: list[Start]) -> Scene:
    """Scene with the balls drawn so far, which are not turned yet."""
    return _scene(
        {
            **fields,
            "positions_m": [start.position_m for start in starts],
            "velocities_m_s": [start.velocity_m_s for start in starts],
            "orientations_xyzw": [(0, 0, 0, 1)] * len(starts),
            # Lists of all balls, drawn or given already: they do not decide about a start.
            "mass_ratios": None,
            "spins_rad_s": None,
        }
    )


def _scene(fields: Mapping[str, Any]) -> Scene:
    try:
        return Scene.model_validate(fields)
    except ValidationError as error:
        first = error.errors()[0]
        message = first["msg"].removeprefix("Value error, ")
        # A rule over several fields begins with the name of the one that breaks it.
        name = str(first["loc"][0]) if first["loc"] else message.split()[0]
        raise SceneParametersError(name, fields.get(name), message) from error


def _require_room(fields: Mapping[str, Any]) -> None:
    """Refuse bowls that no ball of the radius rolls in: simulating them finds that out slowly."""
    ratio, radius = fields["axis_ratio"], fields["radius_m"]
    if radius > WEDGED * ratio**2:
        least = math.sqrt(radius / WEDGED)
        raise SceneParametersError(
            "axis_ratio",
            ratio,
            f"at least {least:.3f} for a ball of radius {radius} m: in a narrower bowl it "
            "touches both sides before it reaches the bottom",
        )


def _draw_bowl(scenario: Scenario, generator: np.random.Generator) -> dict[str, Any]:
    ratio = generator.uniform(0.5, 1.0)
    return {"axis_ratio": 1.0 if scenario == "hemisphere" else ratio}


def _draw_landscape(generator: np.random.Generator) -> dict[str, Any]:
    """Visible part of the noise plane, and a light beyond one of its corners."""
    light_x, light_y = (generator.choice([-1, 1], 2) * generator.uniform(1, 1.5, 2)).tolist()
    scale = generator.uniform(0.2, 0.7)
    farthest = NOISE_PLANE_SIDE_M / 2 - math.sqrt(2) * HEIGHTFIELD_HALF_WIDTH_M
    offset_x, offset_y = generator.uniform(-farthest, farthest, 2).tolist()
    return {
        "noise_scale": scale,
        "noise_offset_m": (offset_x, offset_y),
        "light_position_m": (light_x, light_y, LIGHT_HEIGHT_M),
    }


def draw_material(generator: np.random.Generator, objects: int) -> dict[str, Any]:
    """Material properties of real tables and balls, from polished wood to thick cloth."""
    ratios = np.exp(generator.uniform(-math.log(2), math.log(2), objects)).tolist()
    equal_masses = bool(generator.random() < 0.7)
    return {
        "friction": generator.uniform(0.1, 0.4),
        "ball_friction": generator.uniform(0.02, 0.15),
        "wall_friction": generator.uniform(0, 0.2),
        "rolling_resistance": _log_uniform(generator, 0.003, 0.1),
        "damping": generator.uniform(0, 0.05),
        "ball_restitution": generator.uniform(0.7, 0.98),
        "wall_restitution": generator.uniform(0.5, 0.95),
        "mass_ratios": [1.0] * objects if equal_masses else ratios,
    }


def _draw_table(generator: np.random.Generator) -> dict[str, Any]:
    """Draw slope, cushions and ball size; half of the tables are level, a third has no cushions."""
    slope = generator.uniform(-0.06, 0.06, 2).tolist()
    level = bool(generator.random() < 0.5)
    left, bottom, right, top = generator.uniform(0.55, 0.96 * TABLE_HALF_WIDTH_M, 4).tolist()
    walled = bool(generator.random() < 2 / 3)
    radius = _log_uniform(generator, 0.03, 0.15)
    return {
        "radius_m": radius,
        "slope": (0.0, 0.0) if level else tuple(slope),
        "walls_m": (-left, -bottom, right, top) if walled else OUT_OF_VIEW_M,
    }


def _table_starts(fields: Mapping[str, Any], generator: np.random.Generator) -> Callable[[], Start]:
    """Draw starts anywhere on the table; every second ball after the first is at rest.

    A moving ball slides, rolls or does something in between, with a random spin about the normal.
    """
    radius = fields["radius_m"]
    table = Table(fields["slope"], fields["walls_m"])
    room = TABLE_HALF_WIDTH_M
    left, bottom = (max(side, -room) for side in fields["walls_m"][:2])
    right, top = (min(side, room) for side in fields["walls_m"][2:])
    first = True

    def draw() -> Start:
        nonlocal first
        x = _between(generator, left + radius, right - radius)
        y = _between(generator, bottom + radius, top - radius)
        contact = table.contact_at(x, y)
        position = _resting_on(contact, radius)
        rolling_share, side_spin = generator.uniform(0, 1), generator.normal(0, 10)
        speed, direction = _log_uniform(generator, 0.3, 8), generator.uniform(-math.pi, math.pi)
        rests = not first and bool(generator.random() < 0.5)
        first = False
        if rests:
            return Start(position, (0.0, 0.0, 0.0))
        heading = np.array([math.cos(direction), math.sin(direction), 0.0])
        along = _tangential(heading, contact.normal)
        velocity = speed * along / np.linalg.norm(along)
        normal = np.asarray(contact.normal)
        spin = rolling_share * np.cross(normal, velocity) / radius + side_spin * normal
        return Start(position, _vector(velocity), _vector(spin))

    return draw


def _between(generator: np.random.Generator, low: float, high: float) -> float:
    """Draw uniformly; walls without room for a ball are left to the scene's own check."""
    return generator.uniform(min(low, high), max(low, high))


def _log_uniform(generator: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(generator.uniform(math.log(low), math.log(high))))


def _bowl_starts(
    fields: Mapping[str, Any], objects: int, generator: np.random.Generator
) -> Callable[[], Start]:
    """Draw starts at random angles on the bowl with tangential velocities."""
    bowl = EllipsoidalBowl(fields["axis_ratio"], fields["rotation_rad"])

    def draw() -> Start:
        polar = -generator.uniform(-9 * math.pi / 10, -math.pi / 2)
        contact = bowl.point_at(polar, generator.uniform(-math.pi, math.pi))
        velocity = _tangential(_draw_velocity(generator, 5, 10), contact.normal)
        if objects > 1:
            velocity *= generator.uniform(10, 15) / np.linalg.norm(velocity)
        return Start(_resting_on(contact, fields["radius_m"]), _vector(velocity))

    return draw


def _heightfield_starts(
    fields: Mapping[str, Any], generator: np.random.Generator
) -> Callable[[], Start]:
    """Draw starts anywhere within the walls, let down onto the ground from the camera."""
    radius = fields["radius_m"]
    room = HEIGHTFIELD_HALF_WIDTH_M - radius
    surface = Heightfield(fields["noise_scale"], fields["noise_offset_m"], fields["rotation_rad"])

    def draw() -> Start:
        x, y = generator.uniform(-room, room, 2).tolist()
        centre = (x, y, surface.resting_height(x, y, radius))
        normal = surface.contacts(centre, radius)[0].normal
        return Start(centre, _vector(_tangential(_draw_velocity(generator, 2, 4), normal)))

    return draw


def _draw_velocity(generator: np.random.Generator, low: float, high: float) -> np.ndarray:
    """Horizontal velocity: each component uniform in low..high m/s with a random sign."""
    signs = generator.choice([-1, 1], 2)
    return np.append(signs * generator.uniform(low, high, 2), 0.0)


def _tangential(velocity: np.ndarray, normal: Vector3) -> np.ndarray:
    return velocity - np.dot(velocity, normal) * np.asarray(normal)


def _resting_on(contact: Contact, radius: float) -> Vector3:
    return _vector(np.asarray(contact.point) + radius * np.asarray(contact.normal))


def _draw_orientation(generator: np.random.Generator) -> tuple[float, float, float, float]:
    return pybullet.getQuaternionFromEuler(generator.uniform(-math.pi, math.pi, 3).tolist())


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z
