"""Cache of the backgrounds and ground maps of the scenes of a data set.

Both take longer to compute than all other parts of a training window.
"""

import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float16, UInt8
from tqdm import tqdm

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.simulation.rendering import Renderer
from training.common.processes import process_pool
from training.data.rest_height_map import resting_ground
from training.data.shards import load_recordings


class SceneCache(NamedTuple):
    """Of every scene, in order."""

    empty: UInt8[np.ndarray, "scenes 128 128 3"]
    """The frame without balls."""
    ground: Float16[np.ndarray, "scenes 3 cells cells"]
    """Map of :func:`training.data.rest_height_map.resting_ground`."""


def load_scene_cache(shards: Sequence[Path], workers: int) -> SceneCache:
    """Compute and keep the cache of every scene of some shards; results are kept beside them."""
    missing = [shard for shard in shards if not all(file.exists() for file in _files(shard))]
    if missing:
        with process_pool(workers) as pool:
            done = pool.imap_unordered(_cache_shard, missing)
            for _ in tqdm(done, total=len(missing), desc="scene_cache", unit="shard"):
                pass
    kept = [[np.load(file) for file in _files(shard)] for shard in shards]
    return SceneCache(*(np.concatenate(parts) for parts in zip(*kept, strict=True)))


def _files(shard: Path) -> list[Path]:
    """Files of a shard's scene cache, one a field."""
    return [shard.with_suffix(f".{name}.npy") for name in SceneCache._fields]


def _cache_shard(shard: Path) -> None:
    scenes = [recording.scene for recording in load_recordings([shard])]
    made = SceneCache(
        np.stack([
            Renderer(scene, camera_for(scene.scenario, NETWORK_FRAME_SIZE)).empty
            for scene in scenes
        ]),
        np.stack([resting_ground(scene) for scene in scenes]).astype(np.float16),
    )  # fmt: skip
    for file, array in zip(_files(shard), made, strict=True):
        # Two commands may cache the same shard at once.
        unfinished = file.with_suffix(f".{uuid.uuid4().hex}.npy")
        np.save(unfinished, array)
        unfinished.rename(file)
