"""Rigid-body physics of one scene in PyBullet, with contact against exact surfaces.

Triangle meshes eat energy at every facet. Here a static plane follows every ball instead: before
each step it is laid at the surface point nearest to the ball's centre with the exact normal, and
Bullet solves contact, friction, spin and impacts between balls as ever. The energy error falls
with the square of the step (0.3 % in two seconds of rolling at 360 Hz; docs/decisions/0011).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rollcast.camera import HEIGHTFIELD_HALF_WIDTH_M
from rollcast.scene import Quaternion, Scene, Vector3
from rollcast.simulation.bullet import pybullet
from rollcast.surfaces import BOWL_RADIUS_M, EllipsoidalBowl, Surface, surface_of
from rollcast.trajectory import FRAME_RATE_HZ, Trajectory

STEP_RATE_HZ = 360
"""Steps per second: three substeps of 120 Hz, as in the paper's simulation details."""
STEPS_PER_FRAME = STEP_RATE_HZ // FRAME_RATE_HZ

BALL_RESTITUTION = 0.7
"""Restitution between two balls (paper, section 3.1) unless the scene sets it; surfaces have none,
and the walls of heightfields are elastic."""

GRAVITY_M_S2 = 9.81

_MAX_CONTACTS = 4
"""Planes a ball; more than four simultaneous touching points were never seen on heightfields."""

_OUT_OF_REACH_M = -100.0
_BALLS, _WALLS = 1, 2
_SURFACE_ERROR_REDUCTION = 0.08
"""Share of a ball's depth in its surface that a step takes back; Bullet's own figure."""
_RIGID_N_S_M = 1e9
"""Contact damping so large that a contact is as good as rigid."""

_UNLIMITED = 1e6
"""Bullet stops every component of a spin at 100 rad/s otherwise, which small balls exceed."""


@dataclass(frozen=True)
class Material:
    """Parameters missing in the paper, calibrated to its published averages (decision 0014)."""

    friction: float = 0.5
    """Coefficient of every body; Bullet multiplies those of two bodies in contact."""
    rolling_resistance: float = 0.06
    """Resisting torque per normal force, in ball radii; it also slows the spin about the normal."""
    damping: float = 0.03
    """Bullet's coefficient d: dv/dt = -d v (1 + |v|) in m/s, and likewise for the spin in rad/s."""

    def __post_init__(self) -> None:
        if self.rolling_resistance > 0 and self.friction <= 0:
            raise ValueError("rolling_resistance needs friction, because Bullet multiplies the two")


class _Coefficients(NamedTuple):
    """Coefficients of a scene's bodies; Bullet multiplies those of two bodies in contact."""

    ball_friction: float
    ground_friction: float
    wall_friction: float
    ball_restitution: float
    wall_restitution: float
    rolling_resistance: float
    damping: float

    @classmethod
    def of(cls, scene: Scene, default: Material) -> "_Coefficients":
        """Split the scene's coefficients of pairs; without them, use the default material."""
        ball = default.friction if scene.ball_friction is None else math.sqrt(scene.ball_friction)
        ground = default.friction if scene.friction is None else scene.friction / ball
        if scene.friction is None and scene.ball_friction is not None:
            ground = default.friction**2 / ball
        restitution = math.sqrt(_given(scene.ball_restitution, BALL_RESTITUTION))
        return cls(
            ball,
            ground,
            scene.wall_friction / ball if scene.wall_friction else 0.0,
            restitution,
            _given(scene.wall_restitution, 1.0) / restitution,
            _given(scene.rolling_resistance, default.rolling_resistance),
            _given(scene.damping, default.damping),
        )


def _given(value: float | None, default: float) -> float:
    return default if value is None else value


class BodyStates(NamedTuple):
    """Centres (m), orientations (x, y, z, w) and angular velocities (rad/s) of all balls."""

    centres: list[Vector3]
    orientations: list[Quaternion]
    spins: list[Vector3]


class World:
    """One scene, stepped frame by frame inside a PyBullet client that is used again and again.

    A client costs about 25 MB that PyBullet never gives back, so make one a process.
    """

    def __init__(self, material: Material | None = None, steps_per_frame: int = STEPS_PER_FRAME):
        self._material = material or Material()
        self._steps_per_frame = steps_per_frame
        self._client = pybullet.connect(pybullet.DIRECT)

    def close(self) -> None:
        """Disconnect the PyBullet client."""
        pybullet.disconnect(self._client)

    def load(self, scene: Scene, surface: Surface | None = None) -> None:
        """Replace the content of the world by the start of ``scene``.

        Parameters
        ----------
        surface
            Surface that replaces the scene's own.
        """
        client = self._client
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / (FRAME_RATE_HZ * self._steps_per_frame),
            numSolverIterations=50,
            restitutionVelocityThreshold=0,
            contactBreakingThreshold=1e-5,
            # Bullet adds the correction of an overlap to the rebound, so walls would give back
            # more than they got. Only the surfaces' planes correct, by a stiffness of their own.
            contactERP=0,
            physicsClientId=client,
        )
        self._radius = scene.radius_m
        self._coefficients = _Coefficients.of(scene, self._material)
        self._masses = scene.mass_ratios or (1.0,) * scene.objects
        self.surface: Surface = surface_of(scene) if surface is None else surface
        sphere = pybullet.createCollisionShape(
            pybullet.GEOM_SPHERE, radius=scene.radius_m, physicsClientId=client
        )
        plane = pybullet.createCollisionShape(
            pybullet.GEOM_PLANE, planeNormal=[0, 0, 1], physicsClientId=client
        )
        # PyBullet would make pictures of bodies without looks, which takes ten times as long.
        self._visual_shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=(0.01, 0.01, 0.01), physicsClientId=client
        )
        self._balls = [self._make_ball(scene, k, sphere) for k in range(scene.objects)]
        self._planes = [
            [self._make_surface_plane(k, plane) for _ in range(_MAX_CONTACTS)]
            for k in range(scene.objects)
        ]
        half = HEIGHTFIELD_HALF_WIDTH_M
        walls = (-half, -half, half, half) if scene.scenario == "heightfield" else scene.walls_m
        if walls is not None:
            self._make_walls(*walls)
        self._centres = list(scene.positions_m)
        self.touching: list[list[Vector3]] = [[] for _ in self._balls]

    # Bullet multiplies the two bodies' coefficients of restitution and of friction.
    def _make_ball(self, scene: Scene, index: int, shape: int) -> int:
        client = self._client
        spin = (0, 0, 0) if scene.spins_rad_s is None else scene.spins_rad_s[index]
        own = self._coefficients
        body = pybullet.createMultiBody(
            self._masses[index], shape, self._visual_shape, scene.positions_m[index],
            scene.orientations_xyzw[index], physicsClientId=client,
        )  # fmt: skip
        pybullet.resetBaseVelocity(body, scene.velocities_m_s[index], spin, physicsClientId=client)
        pybullet.changeDynamics(
            body, -1, lateralFriction=own.ball_friction, rollingFriction=0,
            spinningFriction=0, restitution=own.ball_restitution,
            linearDamping=own.damping, angularDamping=own.damping,
            maxJointVelocity=_UNLIMITED, physicsClientId=client,
        )  # fmt: skip
        group = 4 << index
        pybullet.setCollisionFilterGroupMask(
            body, -1, _BALLS | group, _BALLS | _WALLS | group, physicsClientId=client
        )
        return body

    def _make_surface_plane(self, index: int, shape: int) -> int:
        """Make a plane that only ball ``index`` can touch."""
        client = self._client
        body = pybullet.createMultiBody(
            0, shape, self._visual_shape, (0, 0, _OUT_OF_REACH_M), physicsClientId=client
        )
        own = self._coefficients
        # Bullet multiplies the resistance of one body by the friction of the other.
        resistance = (
            own.rolling_resistance * self._radius / own.ball_friction
            if own.rolling_resistance
            else 0.0
        )
        # Bullet corrects a share dt k / (dt k + d) of an overlap.
        rate = FRAME_RATE_HZ * self._steps_per_frame
        share = _SURFACE_ERROR_REDUCTION
        stiffness = _RIGID_N_S_M * rate * share / (1 - share)
        pybullet.changeDynamics(
            body, -1, lateralFriction=own.ground_friction, rollingFriction=resistance,
            spinningFriction=resistance, restitution=0, contactStiffness=stiffness,
            contactDamping=_RIGID_N_S_M, physicsClientId=client,
        )  # fmt: skip
        group = 4 << index
        pybullet.setCollisionFilterGroupMask(body, -1, group, group, physicsClientId=client)
        return body

    def _make_walls(self, left: float, bottom: float, right: float, top: float) -> None:
        """Make four vertical planes that face inwards."""
        client, own = self._client, self._coefficients
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_PLANE, planeNormal=[-x, -y, 0], physicsClientId=client
            )
            origin = (right if x > 0 else left, top if y > 0 else bottom, 0)
            body = pybullet.createMultiBody(
                0, shape, self._visual_shape, origin, physicsClientId=client
            )
            pybullet.changeDynamics(
                body, -1, lateralFriction=own.wall_friction, restitution=own.wall_restitution,
                physicsClientId=client,
            )  # fmt: skip
            pybullet.setCollisionFilterGroupMask(body, -1, _WALLS, _BALLS, physicsClientId=client)

    def step_frame(self) -> None:
        """Advance by one frame."""
        for _ in range(self._steps_per_frame):
            for index, centre in enumerate(self._centres):
                self._lay_planes(index, centre)
            pybullet.stepSimulation(physicsClientId=self._client)
            self._centres = [
                pybullet.getBasePositionAndOrientation(ball, physicsClientId=self._client)[0]
                for ball in self._balls
            ]

    def _lay_planes(self, index: int, centre: Vector3) -> None:
        contacts = self.surface.contacts(centre, self._radius)[:_MAX_CONTACTS]
        before = len(self.touching[index])
        self.touching[index] = [contact.point for contact in contacts]
        for plane, (point, normal) in zip(self._planes[index], contacts, strict=False):
            pybullet.resetBasePositionAndOrientation(
                plane, point, _turn_from_vertical(normal), physicsClientId=self._client
            )
        for plane in self._planes[index][len(contacts) : before]:
            pybullet.resetBasePositionAndOrientation(
                plane, (0, 0, _OUT_OF_REACH_M), (0, 0, 0, 1), physicsClientId=self._client
            )

    def left_bowl(self) -> bool:
        """Return whether a ball's contact point has passed the rim (never on a heightfield)."""
        return isinstance(self.surface, EllipsoidalBowl) and any(
            point[2] > BOWL_RADIUS_M for points in self.touching for point in points
        )

    def can_leave_bowl(self) -> bool:
        """Return whether the total energy suffices to lift a ball to the rim."""
        if not isinstance(self.surface, EllipsoidalBowl):
            return False
        energy = 0.0
        for ball, centre, mass in zip(self._balls, self._centres, self._masses, strict=True):
            v, w = pybullet.getBaseVelocity(ball, physicsClientId=self._client)
            # A solid sphere turns with inertia 2/5 m r^2.
            spin = 0.4 * self._radius**2 * np.dot(w, w)
            height = centre[2] - self._radius
            energy += mass * (0.5 * (np.dot(v, v) + spin) + GRAVITY_M_S2 * height)
        return energy >= min(self._masses) * GRAVITY_M_S2 * (BOWL_RADIUS_M - self._radius)

    def speeds_m_s(self) -> list[float]:
        """Speed of every ball's centre."""
        return [math.hypot(*velocity) for velocity in self.velocities_m_s()]

    def velocities_m_s(self) -> list[Vector3]:
        """Velocity of every ball's centre."""
        return [
            pybullet.getBaseVelocity(ball, physicsClientId=self._client)[0] for ball in self._balls
        ]

    def place(self, state: BodyStates, velocities_m_s: Sequence[Vector3]) -> None:
        """Go on from another state of the balls, with their centres' velocities."""
        moves = zip(self._balls, *state, velocities_m_s, strict=True)
        for ball, centre, orientation, spin, velocity in moves:
            pybullet.resetBasePositionAndOrientation(
                ball, centre, orientation, physicsClientId=self._client
            )
            pybullet.resetBaseVelocity(ball, velocity, spin, physicsClientId=self._client)
        self._centres = list(state.centres)

    def state(self) -> BodyStates:
        """Return the current state of the balls."""
        poses = [
            pybullet.getBasePositionAndOrientation(ball, physicsClientId=self._client)
            for ball in self._balls
        ]
        spins = [
            pybullet.getBaseVelocity(ball, physicsClientId=self._client)[1] for ball in self._balls
        ]
        return BodyStates([pose[0] for pose in poses], [pose[1] for pose in poses], spins)


def _turn_from_vertical(normal: Vector3) -> Quaternion:
    """Shortest rotation that turns +z into ``normal`` (which never points straight down)."""
    nx, ny, nz = normal
    length = math.sqrt(nx * nx + ny * ny + (1 + nz) * (1 + nz))
    return -ny / length, nx / length, 0.0, (1 + nz) / length


def as_trajectory(states: Sequence[BodyStates]) -> Trajectory:
    """Stack states of :meth:`World.state` into a trajectory."""
    positions, orientations, spins = zip(*states, strict=True)
    return Trajectory(np.array(positions), np.array(orientations), np.array(spins))
