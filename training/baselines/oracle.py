"""The simulator as a forecaster, a baseline that the paper lacks: the irreducible error.

It uses the true surface and material. Started from the true state, it measures the error of the
restart; started from a state estimated from four noisy positions, the error that no method with
four frames of that accuracy can avoid.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Quaternion, Scene, Vector3
from rollcast.simulation.physics import BodyStates, World
from rollcast.surfaces import HEIGHTFIELD_HALF_WIDTH_M
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES

ITERATIONS = 4
"""Gauss-Newton iterations; after the third, the fit changes by less than 0.01 px."""
SHARES = (1.0, 0.5, 0.25, 0.125)
"""Fractions of a step; the first one that improves the fit is taken."""
FARTHEST_M = 0.1
"""Maximum correction of the observed position at t = -3 along an axis."""
DIFFERENCES = (1e-3, 1e-2)
"""Steps in metres and metres a second over which the fit's derivatives are taken."""
_UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
_LOWEST_M, _HIGHEST_M, _HALVINGS = -1.0, 2.0, 24


@dataclass(frozen=True)
class Path:
    """Centres [N, T, 2] in 128-px units and angular velocities [N, T, 3] in rad/s, from t = 0."""

    positions: np.ndarray
    angular_velocities: np.ndarray


class Oracle:
    """Forecasts scenes by simulating them. Owns a PyBullet client: one a process."""

    def __init__(self) -> None:
        self._world = World()

    def close(self) -> None:
        """Give the physics client back."""
        self._world.close()

    def from_truth(self, scene: Scene, start: int, horizon: int) -> Path:
        """Restart from the true state of t = 0.

        Parameters
        ----------
        start
            Frame of the simulation that is t = -3.
        """
        world = self._world
        world.load(scene)
        for _ in range(start + FIRST_FORECAST_FRAME):
            world.step_frame()
        state, velocities = world.state(), world.velocities_m_s()
        world.load(scene)
        world.place(state, velocities)
        return self._path(scene, [state, *self._steps(horizon - 1)])

    def from_positions(
        self, scene: Scene, seen: Float[np.ndarray, "objects 4 2"], horizon: int
    ) -> Path:
        """Restart from the motion that explains seen positions best.

        A least-squares fit of where balls that rest on the surface and roll without slipping are
        at t = -3, and how fast.

        Parameters
        ----------
        seen
            Positions of t = -3..0 in 128-px units.
        """
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        plane = camera.unproject(seen)
        frames = OBSERVED_FRAMES - 1
        speed = (plane[:, 1] - plane[:, 0]) / (1 / FRAME_RATE_HZ)
        motion = np.concatenate([plane[:, 0], speed], axis=1)
        steps = np.tile(np.repeat(DIFFERENCES, 2), (scene.objects, 1))
        self._world.load(scene)
        plain = self._seen(scene, motion, frames)
        for _ in range(ITERATIONS):
            columns: list[np.ndarray] = []
            for ball, value in np.ndindex(*motion.shape):
                moved = motion.copy()
                moved[ball, value] += steps[ball, value]
                changed = self._seen(scene, moved, frames) - plain
                columns.append(changed.ravel() / steps[ball, value])
            off = (seen - plain).ravel()
            change = np.linalg.lstsq(np.stack(columns, axis=1), off)[0].reshape(motion.shape)
            # Near walls and over edges the whole step may lead away.
            for share in SHARES:
                tried = motion + share * change
                tried[:, :2] = np.clip(
                    tried[:, :2], plane[:, 0] - FARTHEST_M, plane[:, 0] + FARTHEST_M
                )
                reached = self._seen(scene, tried, frames)
                if np.linalg.norm(seen - reached) < np.linalg.norm(off):
                    motion, plain = tried, reached
                    break
            else:
                break
        states = self._rolled(scene, motion, frames + horizon - 1)
        return self._path(scene, states[frames:])

    def _seen(self, scene: Scene, motion: np.ndarray, frames: int) -> np.ndarray:
        """Positions [N, frames + 1, 2] of balls that begin with a motion."""
        return self._path(scene, self._rolled(scene, motion, frames)).positions

    def _rolled(self, scene: Scene, motion: np.ndarray, frames: int) -> list[BodyStates]:
        state, velocities = self._rolling(scene, motion)
        self._world.place(state, velocities)
        return [state, *self._steps(frames)]

    def _rolling(self, scene: Scene, motion: np.ndarray) -> tuple[BodyStates, list[Vector3]]:
        """State and velocities of balls that roll on the surface with motions [N, 4]."""
        centres: list[Vector3] = []
        velocities: list[Vector3] = []
        spins: list[Vector3] = []
        room = math.inf
        if scene.scenario == "heightfield":
            room = HEIGHTFIELD_HALF_WIDTH_M - scene.radius_m
        for seen_x, seen_y, vx, vy in motion.tolist():
            # Noise may put a ball into a wall.
            x, y = (min(max(value, -room), room) for value in (seen_x, seen_y))
            centre = (x, y, self._resting_height(scene, x, y))
            contacts = self._world.surface.contacts(centre, scene.radius_m)
            normal = np.array(contacts[0].normal)
            velocity = np.array([vx, vy, -(normal[0] * vx + normal[1] * vy) / normal[2]])
            centres.append(centre)
            velocities.append(_vector(velocity))
            spins.append(_vector(np.cross(normal, velocity) / scene.radius_m))
        return BodyStates(centres, [_UPRIGHT] * scene.objects, spins), velocities

    def _resting_height(self, scene: Scene, x: float, y: float) -> float:
        """Height of the centre of a ball that touches the surface, by halving."""
        low, high = _LOWEST_M, _HIGHEST_M
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            if self._world.surface.clears((x, y, middle), scene.radius_m):
                high = middle
            else:
                low = middle
        return high

    def _steps(self, frames: int) -> list[BodyStates]:
        states: list[BodyStates] = []
        for _ in range(frames):
            self._world.step_frame()
            states.append(self._world.state())
        return states

    def _path(self, scene: Scene, states: Sequence[BodyStates]) -> Path:
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        centres = np.array([state.centres for state in states])
        spins = np.array([state.spins for state in states])
        return Path(camera.project(centres).swapaxes(0, 1), spins.swapaxes(0, 1))


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z
