"""Makes data sets: simulates the scenes of a split and stores their trajectories in shards.

A shard holds scene parameters and trajectories, no frames: those are rendered while training.
Shards that exist are kept, so an interrupted run goes on where it stopped.
"""

import dataclasses
import hashlib
import io
import json
import multiprocessing
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fsspec.core import url_to_fs
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


@dataclass(frozen=True)
class Shard:
    """Scenes that are simulated together and stored in one file.

    Attributes
    ----------
    address
        Of the file, as fsspec reads it: a path, or ``s3://...`` and the like.
    """

    source: Source
    address: str
    seeds: tuple[int, ...]

    def exists(self) -> bool:
        """Whether it has been stored, whole."""
        files, path = url_to_fs(self.address)
        return files.exists(path)

    def make(self) -> None:
        """Simulate and store it: the same bytes wherever and whenever that is done."""
        radius_m = self.source.radius_m
        parameters = {} if radius_m is None else {"radius_m": radius_m}
        scenario, objects = self.source.scenario, self.source.objects
        simulator = Simulator()
        made = [
            simulator.sequence(scenario, objects, seed, STORED_FRAMES, 0, parameters)
            for seed in self.seeds
        ]
        simulator.close()
        data = io.BytesIO()
        orientations = [sequence.trajectory.orientations_xyzw for sequence in made]
        spins = [sequence.trajectory.angular_velocities_rad_s for sequence in made]
        np.savez(
            data,
            scenes=np.array([sequence.scene.model_dump_json() for sequence in made]),
            positions=np.stack([s.trajectory.positions_m for s in made]).astype(np.float32),
            orientations=np.stack(orientations).astype(np.float32),
            spins=np.stack(spins).astype(np.float32),
        )
        files, path = url_to_fs(self.address)
        files.makedirs(files._parent(path), exist_ok=True)
        # Under its own name only once it is whole: a worker may die at any time.
        unfinished = f"{path}.{uuid.uuid4().hex}"
        files.pipe_file(unfinished, data.getvalue())
        files.mv(unfinished, path)


Makers = Callable[[Sequence[Shard]], Iterable[object]]
"""Makes shards, in any order, and yields something for each that is there."""


def split_shards(source: Source, split: Split, scenes: int, folder: str) -> list[Shard]:
    """Shards of the first ``scenes`` scenes of a split (whole ones), in a folder."""
    wanted = seeds(split, scenes)
    return [
        Shard(source, f"{folder}/{wanted[k]}.npz", tuple(wanted[k : k + SHARD_SCENES]))
        for k in range(0, scenes, SHARD_SCENES)
    ]


def make_missing(shards: Sequence[Shard], make: Makers, title: str) -> None:
    """Make the shards that are not there yet."""
    missing = [shard for shard in shards if not shard.exists()]
    if missing:
        for _ in tqdm(make(missing), total=len(missing), desc=title, unit="shard"):
            pass


def in_processes(workers: int) -> Makers:
    """Make shards in so many processes of this machine."""

    def make(shards: Sequence[Shard]) -> Iterator[object]:
        context = multiprocessing.get_context("spawn")
        with context.Pool(workers, maxtasksperchild=SHARDS_PER_WORKER) as pool:
            yield from pool.imap_unordered(Shard.make, shards)

    return make


def simulate_split(source: Source, split: Split, scenes: int, workers: int) -> list[Path]:
    """Simulate the first ``scenes`` scenes of a split (whole shards); return the shards' files."""
    folder = data_folder(source, split)
    shards = split_shards(source, split, scenes, str(folder))
    make_missing(shards, in_processes(workers), f"{source.name} {split}")
    return [Path(shard.address) for shard in shards]


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
