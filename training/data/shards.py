"""Makes data sets: simulates the scenes of a split and stores their trajectories in shards.

A shard holds scene parameters and trajectories, no frames: those are rendered while training.
Shards that exist are kept, so an interrupted run goes on where it stopped.
"""

import dataclasses
import hashlib
import io
import json
import math
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from fsspec.core import url_to_fs
from tqdm import tqdm

from rollcast.scene import SCENARIOS, Scenario, Scene
from rollcast.simulation import SceneRejectedError, Simulator
from rollcast.simulation import Sequence as Simulated
from rollcast.simulation.physics import STEPS_PER_FRAME, Material
from rollcast.surfaces import NOISE_AMPLITUDE_M
from rollcast.trajectory import Trajectory
from training.common.processes import process_pool
from training.common.settings import runs_folder
from training.data.splits import Split, seeds

WORLD_REVISION = 2
"""Version of the simulated trajectories, raised with every change that alters golden values."""

SHARD_SCENES = 50
STORED_FRAMES = 288
"""Frames kept of every simulation, from its start."""

VARIETY_STREAM = 1
"""Seed suffix that separates draws of :class:`Variety` from those of the scene."""

SHARDS_PER_WORKER = 4
"""Shards after which a worker process is replaced: PyBullet leaks (decision 0104)."""


@dataclass(frozen=True)
class SceneOverride:
    """Changes of scenes from the training distribution.

    Attributes
    ----------
    name
        For folders and tables.
    parameters
        Fields of :class:`rollcast.scene.Scene` that are fixed, with their values.
    speed
        Factor on the drawn start velocities.

    Scenes that are rejected with it are left out.
    """

    name: str
    parameters: tuple[tuple[str, object], ...] = ()
    speed: float = 1.0


@dataclass(frozen=True)
class Variety:
    """Scene parameters that are drawn for every scene from more than the paper's distributions.

    Each is uniform within its limits, speeds by their logarithm. A scene is a function of its seed.
    """

    name: str = "varied"
    radius_m: tuple[float, float] = (0.03, 0.25)
    axis_ratio: tuple[float, float] = (0.4, 1.0)
    """Axis ratios of ellipsoids; a larger ball raises the lower limit to touch the bottom."""
    light_side_m: float = 2.5
    """Largest x and y of a heightfield's light."""
    light_height_m: tuple[float, float] = (1.0, 4.0)
    heightfield_speed: tuple[float, float] = (0.3, 3.0)
    """Start speed relative to the paper's. Half of the scenes keep the paper's."""
    bowl_speed: tuple[float, float] = (0.4, 1.2)
    materials: bool = False
    """Variation of friction, rolling resistance, drag and start spins as well."""
    friction: tuple[float, float] = (0.05, 1.0)
    rolling_resistance: tuple[float, float] = (0.0, 0.15)
    damping: tuple[float, float] = (0.0, 0.2)
    spin_rad_s: float = 40.0
    """Largest start spin about each axis; half of the scenes start without."""

    def override(self, scenario: Scenario, seed: int) -> SceneOverride:
        """Return the changes of the scene of a seed."""
        generator = np.random.default_rng([seed, SCENARIOS.index(scenario), VARIETY_STREAM])
        radius = generator.uniform(*self.radius_m)
        parameters: dict[str, object] = {"radius_m": radius}
        if scenario == "ellipsoid":
            least = max(self.axis_ratio[0], math.sqrt(radius))
            parameters["axis_ratio"] = generator.uniform(least, self.axis_ratio[1])
        if scenario == "heightfield":
            x, y = generator.uniform(-self.light_side_m, self.light_side_m, 2).tolist()
            parameters["light_position_m"] = (x, y, generator.uniform(*self.light_height_m))
        speeds = self.heightfield_speed if scenario == "heightfield" else self.bowl_speed
        speed = math.exp(generator.uniform(*np.log(speeds)))
        usual = generator.random() < 0.5
        if self.materials:
            parameters["friction"] = generator.uniform(*self.friction)
            parameters["rolling_resistance"] = generator.uniform(*self.rolling_resistance)
            parameters["damping"] = generator.uniform(*self.damping)
            spin = generator.uniform(-self.spin_rad_s, self.spin_rad_s, 3).tolist()
            if generator.random() < 0.5:
                parameters["spins_rad_s"] = (spin,)
        return SceneOverride(self.name, tuple(parameters.items()), 1.0 if usual else speed)


@dataclass(frozen=True)
class Source:
    """One kind of scene of a data set.

    Attributes
    ----------
    radius_m
        Ball radius; None leaves it to the scene's own distribution.
    change
        Changes that all its scenes share.
    variety
        Changes that are drawn for each scene instead.
    """

    scenario: Scenario
    objects: int = 1
    radius_m: float | None = None
    override: SceneOverride | None = None
    variety: Variety | None = None

    def __post_init__(self) -> None:
        if self.variety and (self.override or self.radius_m is not None):
            raise ValueError("variety draws what override and radius_m would fix")

    @property
    def name(self) -> str:
        """Folder name of the source."""
        radius = "" if self.radius_m is None else f"-r{self.radius_m}"
        unusual = self.override or self.variety
        change = "" if unusual is None else f"-{unusual.name.replace(' ', '-')}"
        return f"{self.scenario}-{self.objects}{radius}{change}"

    @property
    def parameters(self) -> dict[str, object]:
        """Fields of all its scenes that are fixed."""
        radius: dict[str, object] = {} if self.radius_m is None else {"radius_m": self.radius_m}
        return radius | dict(() if self.override is None else self.override.parameters)

    def sequence(self, simulator: Simulator, seed: int) -> Simulated | None:
        """Simulate one of its scenes; None when a rejection rule excludes its changes."""
        draw = partial(simulator.sequence, self.scenario, self.objects, seed)
        parameters, override = self.parameters, self.override
        if self.variety is not None:
            override = self.variety.override(self.scenario, seed)
            parameters |= dict(override.parameters)
        if override is None:
            return draw(STORED_FRAMES, 0, parameters)
        try:
            if override.speed != 1:
                usual = draw(1, 0, parameters).scene
                parameters |= usual.model_dump(include={"positions_m", "orientations_xyzw"})
                velocities = override.speed * np.array(usual.velocities_m_s)
                parameters["velocities_m_s"] = velocities.tolist()
            return draw(STORED_FRAMES, 0, parameters)
        except SceneRejectedError:
            return None


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
        simulator = Simulator()
        tried = [self.source.sequence(simulator, seed) for seed in self.seeds]
        made = [sequence for sequence in tried if sequence is not None]
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
"""Function that makes shards in any order and yields one item per shard."""


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
        with process_pool(workers, SHARDS_PER_WORKER) as pool:
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
