"""Case of a study: one scenario with a number of balls, for training and tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Scenario, Scene
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import FIRST_FORECAST_FRAME
from training.baselines.least_squares import POINTS
from training.baselines.states import States, StateSet
from training.data.shards import Recording, SceneOverride, Source, load_recordings, simulate_split
from training.data.splits import Split
from training.data.windows import (
    Window,
    WindowMaker,
    compared_horizon,
    fixed_windows,
    generated_horizon,
)
from training.recipes.compact import ONE_BALL_DATA, several_balls
from training.recipes.recipe import DataShare

COLLISION_STEP = 10
"""Forecast step that the first collision follows (paper, table "Effect of multiple-ball module on
collision estimation")."""
MOVED_APART_M = 0.01
"""Minimum deviation from the undisturbed path after a collision, above rounding."""


@dataclass(frozen=True)
class SceneFilter:
    """Those scenes of which a field lies in a range, the upper end left out."""

    field: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.field.replace('_', ' ')} {self.low:g} to {self.high:g}"

    def holds(self, scene: Scene) -> bool:
        """Whether a scene is one of them."""
        return self.low <= getattr(scene, self.field) < self.high


@dataclass(frozen=True)
class BenchmarkCase:
    """A scenario with so many balls.

    Attributes
    ----------
    change
        Change of the scenes that no training scene has.
    among
        Which of its scenes; None for all.
    horizons
        Values of T that are compared; without, T_train and T_gen.
    colliding
        Whether every test begins COLLISION_STEP steps before the first collision of two balls.
    """

    scenario: Scenario
    objects: int = 1
    override: SceneOverride | None = None
    scene_filter: SceneFilter | None = None
    horizons: tuple[int, ...] = ()
    colliding: bool = False

    @property
    def usual(self) -> "BenchmarkCase":
        """Case with all scenes of the scenario, as in training."""
        return BenchmarkCase(self.scenario, self.objects)

    @property
    def moments(self) -> Mapping[str, int]:
        """Values of T that are compared, by the name of their column."""
        if self.colliding:
            return {f"{T} after the collision": COLLISION_STEP + T for T in (5, 10)}
        return {f"T={T}": T for T in self.horizons or (self.trained_horizon, self.horizon)}

    @property
    def name(self) -> str:
        """Short name, for folders and captions."""
        return (
            self.source.name
            if self.scene_filter is None
            else f"{self.source.name}, {self.scene_filter}"
        )

    @property
    def condition(self) -> str:
        """Condition of its scenes; "" for all scenes of the scenario."""
        if self.colliding:
            return "before the first collision"
        if self.override is not None:
            return self.override.name
        return "" if self.scene_filter is None else str(self.scene_filter)

    @property
    def trained_horizon(self) -> int:
        """T_train."""
        return compared_horizon(self.objects)

    @property
    def horizon(self) -> int:
        """T_gen."""
        return generated_horizon(self.objects)

    @property
    def data(self) -> DataShare:
        """Training scenes, the same as the shipped models'."""
        shares = ONE_BALL_DATA if self.objects == 1 else several_balls(self.objects).data
        return next(share for share in shares if share.source == self.source)

    @property
    def source(self) -> Source:
        """Its kind of scenes."""
        return Source(self.scenario, self.objects, override=self.override)

    def recordings(self, split: Split, scenes: int, workers: int) -> list[Recording]:
        """Load its scenes among the first of a split; simulate missing ones."""
        known = load_recordings(simulate_split(self.source, split, scenes, workers))[:scenes]
        if self.colliding:
            return [moved for one in known if (moved := before_collision(one, self.horizon))]
        return [
            one for one in known if self.scene_filter is None or self.scene_filter.holds(one.scene)
        ]


def before_collision(recording: Recording, horizon: int) -> Recording | None:
    """Cut a recording so that its test starts COLLISION_STEP steps before two balls first collide.

    Two balls collide between two frames if they would lie in each other had they gone on
    approaching as they did, and move apart after it. None where no ball does so from the usual
    start of the test on, or too late for all of a forecast to be known.
    """
    scene, path = recording.scene, recording.trajectory
    start = TEST_START[scene.scenario]
    centres = path.positions_m
    first = len(centres)
    for one, other in combinations(range(scene.objects), 2):
        apart = np.linalg.norm(centres[:, one] - centres[:, other], axis=-1)
        # Of frames k - 1, k and k + 1.
        would_be = 2 * apart[1:-1] - apart[:-2]
        met = (would_be < 2 * scene.radius_m) & (apart[2:] > would_be + MOVED_APART_M)
        after = np.flatnonzero(met) + 1
        after = after[after >= start + FIRST_FORECAST_FRAME + COLLISION_STEP]
        first = min(first, *after.tolist()) if len(after) else first
    cut = first - COLLISION_STEP - FIRST_FORECAST_FRAME - start
    if cut + start + FIRST_FORECAST_FRAME + horizon > len(centres):
        return None
    return Recording(scene, path.window(cut, len(centres) - cut))


class FixedScenes:
    """Scenes of a case from the fixed test start on, as every method needs to see them."""

    def __init__(self, case: BenchmarkCase, split: Split, scenes: int, workers: int) -> None:
        self.case = case
        self.recordings: Sequence[Recording] = case.recordings(split, scenes, workers)
        self.start = TEST_START[case.scenario]

    @cached_property
    def windows(self) -> list[Window]:
        """Frames and truth."""
        return fixed_windows(self.recordings, self.case.horizon, None)

    def windows_until(self, final_step: int) -> list[Window]:
        """Frames and truth up to a step, of which a fifth frame is seen."""
        return fixed_windows(self.recordings, final_step + 1, final_step)

    @cached_property
    def truth(self) -> list[Window]:
        """Truth without frames, which need no rendering."""
        maker = WindowMaker(self.recordings, None)
        horizon = self.case.horizon
        return [
            maker.window(index, self.start, horizon, seen=False)
            for index in range(len(self.recordings))
        ]

    @cached_property
    def states(self) -> States:
        """True states from t = -3 on."""
        return StateSet(self.recordings).fixed(self.case.horizon)

    def seen_positions(self, frames: int) -> Float[np.ndarray, "sequences objects frames 2"]:
        """Return true positions in 128-px units from t = -3 on."""
        camera = camera_for(self.case.scenario, NETWORK_FRAME_SIZE)
        centres = [one.trajectory.window(self.start, frames) for one in self.recordings]
        return np.stack([camera.project(part.positions_m).swapaxes(0, 1) for part in centres])

    def first_spins(self) -> Float[np.ndarray, "sequences objects ten 3"]:
        """Return the true angular velocities of t = -3..6."""
        parts = [one.trajectory.window(self.start, POINTS) for one in self.recordings]
        return np.stack([part.angular_velocities_rad_s.swapaxes(0, 1) for part in parts])
