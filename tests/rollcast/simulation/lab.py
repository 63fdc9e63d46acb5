"""An empty stage for physics: flat ground, plain scenes, and what can be measured of them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rollcast.scene import Quaternion, Scene, Vector3
from rollcast.simulation.physics import GRAVITY_M_S2, Material, World
from rollcast.surfaces import BOWL_RADIUS_M, Contact, EllipsoidalBowl, Surface
from rollcast.trajectory import FRAME_RATE_HZ

FRICTIONLESS = Material(friction=0, rolling_resistance=0, damping=0)
LOSSLESS = Material(rolling_resistance=0, damping=0)
"""Friction makes balls roll, and rolling costs nothing."""


class FlatGround:
    """The plane z = 0."""

    def contacts(self, centre: Vector3, radius: float) -> list[Contact]:
        return [Contact((centre[0], centre[1], 0.0), (0.0, 0.0, 1.0))]

    def clears(self, centre: Vector3, radius: float) -> bool:
        return centre[2] >= radius

    def height_and_normal(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros_like(x), np.stack([0 * x, 0 * x, np.ones_like(x)], axis=-1)


class Motion(NamedTuple):
    """What a world did, frame by frame, the start included."""

    centres: np.ndarray
    """[frames, objects, 3], metres."""
    spins: np.ndarray
    """[frames, objects, 3], rad/s."""
    speeds: np.ndarray
    """[frames, objects], m/s."""
    energies: np.ndarray
    """[frames], joules: all balls together, each of unit mass."""

    @property
    def times(self) -> np.ndarray:
        return np.arange(len(self.speeds)) / FRAME_RATE_HZ


def scene(
    positions: Sequence[Vector3],
    velocities: Sequence[Vector3] | None = None,
    *,
    radius: float = 0.225,
    axis_ratio: float = 1.0,
    rotation: float = 0.0,
    walls: bool = False,
) -> Scene:
    """A scene with its balls where they are wanted; walls come with a heightfield."""
    if walls:
        shape = {
            "scenario": "heightfield",
            "noise_scale": 0.5,
            "noise_offset_m": (0.0, 0.0),
            "light_position_m": (1.2, 1.2, 2.0),
        }
    else:
        shape = {"scenario": "ellipsoid", "axis_ratio": axis_ratio}
    return Scene.model_validate(
        {
            **shape,
            "seed": 0,
            "textured": False,
            "radius_m": radius,
            "rotation_rad": rotation,
            "positions_m": tuple(positions),
            "velocities_m_s": tuple(velocities or [(0.0, 0.0, 0.0)] * len(positions)),
            "orientations_xyzw": ((0.0, 0.0, 0.0, 1.0),) * len(positions),
        }
    )


def at_rest_in_bowl(
    polar_from_bottom: float,
    azimuth: float = 0.0,
    *,
    radius: float = 0.225,
    axis_ratio: float = 1.0,
    rotation: float = 0.0,
) -> Scene:
    """One ball that touches a bowl at these angles of the bowl."""
    bowl = EllipsoidalBowl(axis_ratio, rotation)
    contact = bowl.point_at(np.pi - polar_from_bottom, azimuth)
    x, y, z = np.asarray(contact.point) + radius * np.asarray(contact.normal)
    return scene([(x, y, z)], radius=radius, axis_ratio=axis_ratio, rotation=rotation)


def run(world: World, start: Scene, frames: int, surface: Surface | None = None) -> Motion:
    """Load a scene and step it."""
    world.load(start, surface)
    states, speeds = [world.state()], [world.speeds_m_s()]
    for _ in range(frames):
        world.step_frame()
        states.append(world.state())
        speeds.append(world.speeds_m_s())
    centres = np.array([state.centres for state in states])
    spins = np.array([state.spins for state in states])
    kinetic = 0.5 * np.square(speeds) + 0.2 * start.radius_m**2 * np.sum(spins**2, axis=-1)
    energies = np.sum(kinetic + GRAVITY_M_S2 * centres[..., 2], axis=1)
    return Motion(centres, spins, np.array(speeds), energies)


def angular_frequency(signal: np.ndarray) -> float:
    """Frequency in rad/s of an oscillation about zero, from its first to its last upward zero."""
    rising = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    crossings = rising + signal[rising] / (signal[rising] - signal[rising + 1])
    period = (crossings[-1] - crossings[0]) / (len(crossings) - 1) / FRAME_RATE_HZ
    return 2 * np.pi / period


def distance_from_bowl_centre(centres: np.ndarray) -> np.ndarray:
    """Distance of ball centres from the middle of a hemisphere."""
    return np.linalg.norm(centres - (0, 0, BOWL_RADIUS_M), axis=-1)


def turned(start: Scene) -> Scene:
    """The same scene a quarter turn further about z, counter-clockwise as the camera sees it."""
    half = math.sqrt(0.5)

    def turn(vector: Vector3) -> Vector3:
        return -vector[1], vector[0], vector[2]

    def turn_body(q: Quaternion) -> Quaternion:
        x, y, z, w = q
        return half * (x - y), half * (y + x), half * (z + w), half * (w - z)

    light, slope, walls, spins = (
        start.light_position_m,
        start.slope,
        start.walls_m,
        start.spins_rad_s,
    )
    return start.model_copy(
        update={
            "rotation_rad": start.rotation_rad + math.pi / 2,
            "slope": None if slope is None else (-slope[1], slope[0]),
            "walls_m": None if walls is None else (-walls[3], walls[0], -walls[1], walls[2]),
            "spins_rad_s": None if spins is None else tuple(turn(spin) for spin in spins),
            "light_position_m": None if light is None else turn(light),
            "positions_m": tuple(turn(position) for position in start.positions_m),
            "velocities_m_s": tuple(turn(velocity) for velocity in start.velocities_m_s),
            "orientations_xyzw": tuple(turn_body(q) for q in start.orientations_xyzw),
        }
    )


def mirrored(start: Scene) -> Scene:
    """A bowl scene as a mirror across x = 0 shows it."""
    return start.model_copy(
        update={
            "rotation_rad": -start.rotation_rad,
            "positions_m": tuple((-x, y, z) for x, y, z in start.positions_m),
            "velocities_m_s": tuple((-x, y, z) for x, y, z in start.velocities_m_s),
            "orientations_xyzw": tuple((x, -y, -z, w) for x, y, z, w in start.orientations_xyzw),
        }
    )
