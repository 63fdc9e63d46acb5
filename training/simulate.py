"""Makes data sets: simulates the scenes of a split and stores their trajectories in shards.

A shard holds scene parameters and trajectories, no frames: those are rendered while training.
Shards that exist are kept, so an interrupted run goes on where it stopped.
"""

import dataclasses
import hashlib
import json
import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rollcast.scene import Scenario, Scene
from rollcast.simulation import Simulator
from rollcast.simulation.physics import STEPS_PER_FRAME, Material
from rollcast.surfaces import NOISE_AMPLITUDE_M
from rollcast.trajectory import Trajectory
from training.settings import runs_folder
from training.splits import Split, seeds

WORLD_REVISION = 2
"""Raised by every change of the simulator's code that moves trajectories (golden values tell)."""

SHARD_SCENES = 50
STORED_FRAMES = 288
"""Frames kept of every simulation, from its start."""

SHARDS_PER_WORKER = 4
"""Shards after which a worker process is replaced: PyBullet leaks (design, section 3)."""


@dataclass(frozen=True)
class Source:
    """One kind of scene of a data set.

    Attributes
    ----------
    radius_m
        Ball radius; None leaves it to the scene's own distribution.
    """

    scenario: Scenario
    objects: int = 1
    radius_m: float | None = None

    @property
    def name(self) -> str:
        """Folder name of the source."""
        radius = "" if self.radius_m is None else f"-r{self.radius_m}"
        return f"{self.scenario}-{self.objects}{radius}"


@dataclass(frozen=True)
class Recording:
    """A scene of a data set with its stored trajectory."""

    scene: Scene
    trajectory: Trajectory


def simulate_split(source: Source, split: Split, scenes: int, workers: int) -> list[Path]:
    """Simulate the first ``scenes`` scenes of a split (whole shards); return the shards' files."""
    folder = data_folder(source, split)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = seeds(split, scenes)
    shards = [
        (source, folder / f"{first}.npz", tuple(wanted[k : k + SHARD_SCENES]))
        for k, first in list(enumerate(wanted))[::SHARD_SCENES]
    ]
    missing = [shard for shard in shards if not shard[1].exists()]
    if missing:
        context = multiprocessing.get_context("spawn")
        with context.Pool(workers, maxtasksperchild=SHARDS_PER_WORKER) as pool:
            done = pool.imap_unordered(_make_shard, missing)
            for _ in tqdm(done, total=len(missing), desc=f"{source.name} {split}", unit="shard"):
                pass
    return [path for _, path, _ in shards]


def data_folder(source: Source, split: Split) -> Path:
    """Folder of a split's shards; its name carries a fingerprint of the world's constants."""
    world = {
        "revision": WORLD_REVISION,
        "material": dataclasses.asdict(Material()),
        "steps_per_frame": STEPS_PER_FRAME,
        "noise_amplitude_m": NOISE_AMPLITUDE_M,
        "stored_frames": STORED_FRAMES,
    }
    digest = hashlib.sha256(json.dumps(world, sort_keys=True).encode()).hexdigest()[:8]
    return runs_folder() / "data" / digest / source.name / split


def load_recordings(shards: Sequence[Path]) -> list[Recording]:
    """Load every scene of some shards, in order."""
    recordings: list[Recording] = []
    for path in shards:
        with np.load(path) as shard:
            scenes = [Scene.model_validate_json(text) for text in shard["scenes"]]
            fields = (shard["positions"], shard["orientations"], shard["spins"])
            recordings += [
                Recording(scene, Trajectory(*parts))
                for scene, *parts in zip(scenes, *fields, strict=True)
            ]
    return recordings


def _make_shard(shard: tuple[Source, Path, tuple[int, ...]]) -> None:
    source, path, shard_seeds = shard
    parameters = {} if source.radius_m is None else {"radius_m": source.radius_m}
    simulator = Simulator()
    made = [
        simulator.sequence(source.scenario, source.objects, seed, STORED_FRAMES, 0, parameters)
        for seed in shard_seeds
    ]
    simulator.close()
    unfinished = path.with_suffix(".tmp.npz")
    np.savez(
        unfinished,
        scenes=np.array([sequence.scene.model_dump_json() for sequence in made]),
        positions=np.stack([s.trajectory.positions_m for s in made]).astype(np.float32),
        orientations=np.stack([s.trajectory.orientations_xyzw for s in made]).astype(np.float32),
        spins=np.stack([s.trajectory.angular_velocities_rad_s for s in made]).astype(np.float32),
    )
    unfinished.rename(path)
