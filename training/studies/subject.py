"""What a study's methods are trained and tested on: one scenario with so many balls."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Scenario
from rollcast.simulation.recording import TEST_START
from training.baselines.least_squares import POINTS
from training.baselines.states import States, StateSet
from training.dataset import Window, WindowMaker, compared_horizon, fixed_windows, generated_horizon
from training.recipes.compact import ONE_BALL_DATA, several_balls
from training.recipes.recipe import DataShare
from training.simulate import Recording, Source, load_recordings, simulate_split
from training.splits import Split


@dataclass(frozen=True)
class Subject:
    """A scenario with so many balls."""

    scenario: Scenario
    objects: int = 1

    @property
    def name(self) -> str:
        """Short name, for folders and captions."""
        return Source(self.scenario, self.objects).name

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
        return Source(self.scenario, self.objects)

    def recordings(self, split: Split, scenes: int, workers: int) -> list[Recording]:
        """Load the first scenes of a split; simulate those that are not there."""
        return load_recordings(simulate_split(self.source, split, scenes, workers))[:scenes]


class FixedScenes:
    """Scenes of a subject from the fixed test start on, as every method needs to see them."""

    def __init__(self, subject: Subject, split: Split, scenes: int, workers: int) -> None:
        self.subject = subject
        self.recordings: Sequence[Recording] = subject.recordings(split, scenes, workers)
        self.start = TEST_START[subject.scenario]

    @cached_property
    def windows(self) -> list[Window]:
        """Frames and truth."""
        return fixed_windows(self.recordings, self.subject.horizon, None)

    @cached_property
    def truth(self) -> list[Window]:
        """Truth without frames, which need no rendering."""
        maker = WindowMaker(self.recordings, None)
        horizon = self.subject.horizon
        return [
            maker.window(index, self.start, horizon, seen=False)
            for index in range(len(self.recordings))
        ]

    @cached_property
    def states(self) -> States:
        """True states from t = -3 on."""
        return StateSet(self.recordings).fixed(self.subject.horizon)

    def seen_positions(self, frames: int) -> Float[np.ndarray, "sequences objects frames 2"]:
        """Return true positions in 128-px units from t = -3 on."""
        camera = camera_for(self.subject.scenario, NETWORK_FRAME_SIZE)
        centres = [one.trajectory.window(self.start, frames) for one in self.recordings]
        return np.stack([camera.project(part.positions_m).swapaxes(0, 1) for part in centres])

    def first_spins(self) -> Float[np.ndarray, "sequences objects ten 3"]:
        """Return the true angular velocities of t = -3..6."""
        parts = [one.trajectory.window(self.start, POINTS) for one in self.recordings]
        return np.stack([part.angular_velocities_rad_s.swapaxes(0, 1) for part in parts])
