"""Scenes that satisfy the paper's rejection rules, simulated and cut to the requested frames."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from rollcast.camera import camera_for
from rollcast.errors import SceneRejectedError
from rollcast.scene import Scenario, Scene
from rollcast.simulation.physics import World, as_trajectory
from rollcast.simulation.rendering import Renderer
from rollcast.simulation.sampling import draw_scene, scene_generator
from rollcast.trajectory import Trajectory

MIN_FRAMES = 250
"""Shorter simulations are discarded (paper, section 3.1)."""

STOPPED_M_S = 0.04
"""Balls slower than this for STOPPED_FRAMES have stopped (not only at a turning point)."""

STOPPED_FRAMES = 20

SCREENED_FRAMES = 20

TEST_START: Mapping[Scenario, int] = {
    "hemisphere": 80,
    "ellipsoid": 80,
    "heightfield": 18,
    "table": 4,
}
"""Frame of the simulation that is the first a test sees; calibrated (decision 0014)."""

MAX_ATTEMPTS = 1000
MAX_ATTEMPTS_WITH_PARAMETERS = 200
"""A seed alone always finds its scene; fixed parameters may leave none to be found."""

MAX_CHECKED_FRAMES = 2000
"""Balls that could still leave the bowl after this long are not waited for."""


@dataclass(frozen=True)
class Sequence:
    """A scene with a stretch of its simulation.

    Attributes
    ----------
    start_step
        Index of the first frame, counted from the start of the simulation.
    """

    scene: Scene
    trajectory: Trajectory
    start_step: int

    def render(self, image_size: int) -> UInt8[np.ndarray, "frames size size 3"]:
        """Render every frame."""
        renderer = Renderer(self.scene, camera_for(self.scene.scenario, image_size))
        return renderer.render(self.trajectory)


class Simulator:
    """Draws and simulates scenes. Owns a PyBullet client: one a process, not shared by threads."""

    def __init__(self) -> None:
        self._world = World()

    def close(self) -> None:
        """Give the physics client back."""
        self._world.close()

    def sequence(
        self,
        scenario: Scenario,
        objects: int,
        seed: int,
        steps: int,
        start_step: int | None = None,
        parameters: Mapping[str, object] | None = None,
    ) -> Sequence:
        """Return ``steps`` frames of the scene that a seed names.

        Parameters
        ----------
        start_step
            First frame, counted from the start of the simulation; None is the calibrated test
            start of the scenario.
        parameters
            Fields of :class:`rollcast.scene.Scene` to fix instead of drawing them.

        Raises
        ------
        SceneParametersError
            When a parameter does not fit the scene.
        SceneRejectedError
            When no scene with these parameters keeps the rejection rules.
        """
        start = TEST_START[scenario] if start_step is None else start_step
        generator = scene_generator(scenario, objects, seed)
        attempts = MAX_ATTEMPTS_WITH_PARAMETERS if parameters else MAX_ATTEMPTS
        rejected: Scene | None = None
        for _ in range(attempts):
            scene = draw_scene(
                scenario, objects, seed, generator, parameters or {}, self._last_ball_stays
            )
            if scene == rejected:
                break  # nothing is left to chance
            trajectory = self.simulate(scene, start + steps)
            if trajectory is not None and _in_view(scene, trajectory.window(start, 1)):
                return Sequence(scene, trajectory.window(start, steps), start)
            rejected = scene
        rules = (
            "shows all balls in its first frame"
            if scenario == "table"
            else f"keeps them in the bowl and moving for {MIN_FRAMES} frames"
        )
        raise SceneRejectedError(
            f"no {scenario} scene found with these parameters that starts with all balls clear of "
            f"the surface and {rules}"
        )

    def _last_ball_stays(self, scene: Scene) -> bool:
        """Return whether the last ball starts clear of the others and stays in the bowl at first.

        Balls that leave the bowl without a collision do so within half a second.
        """
        if _balls_overlap(scene):
            return False
        if scene.scenario == "table":
            return True
        alone = {
            "positions_m": scene.positions_m[-1:],
            "velocities_m_s": scene.velocities_m_s[-1:],
            "orientations_xyzw": scene.orientations_xyzw[-1:],
            "mass_ratios": None,
            "spins_rad_s": None,
        }
        self._world.load(scene.model_copy(update=alone))
        for _ in range(SCREENED_FRAMES):
            self._world.step_frame()
            if self._world.left_bowl():
                return False
        return True

    def simulate(self, scene: Scene, frames: int) -> Trajectory | None:
        """Simulate at least ``frames`` frames from the start; None when a rule rejects the scene.

        The verdict does not depend on ``frames``: it needs the first 250 frames, and beyond them
        no more than it takes until the balls have too little energy to reach the rim.
        """
        world = self._world
        world.load(scene)
        clear = all(world.surface.clears(centre, scene.radius_m) for centre in scene.positions_m)
        if not clear or _balls_overlap(scene):
            return None
        states = [world.state()]
        still = 0
        # Balls on a table may come to rest, and there is no rim to pass.
        checked = scene.scenario == "table"
        while len(states) < frames or not checked:
            world.step_frame()
            states.append(world.state())
            if checked:
                continue
            if world.left_bowl() or len(states) > MAX_CHECKED_FRAMES:
                return None
            still = still + 1 if max(world.speeds_m_s()) < STOPPED_M_S else 0
            if still == STOPPED_FRAMES and len(states) <= MIN_FRAMES:
                return None
            checked = len(states) >= MIN_FRAMES and not world.can_leave_bowl()
        return as_trajectory(states)


def _in_view(scene: Scene, shown: Trajectory) -> bool:
    """Return whether the camera sees all ball centres; balls can only leave an open table."""
    if scene.scenario != "table":
        return True
    half_width = camera_for(scene.scenario, 1).half_width_m
    return bool((np.abs(shown.positions_m[..., :2]) < half_width).all())


def _balls_overlap(scene: Scene) -> bool:
    positions = scene.positions_m
    return any(
        math.dist(one, other) < 2 * scene.radius_m
        for index, one in enumerate(positions)
        for other in positions[:index]
    )
