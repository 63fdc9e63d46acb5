"""Clips with tracks as training data: a user's own set-up, or Roll4Real (paper, section 5.3).

A folder holds clips, in any depth: ``NAME.mp4`` (or another video, or a folder ``NAME/`` of images)
beside ``NAME.parquet``, the tracks that ``rollcast track`` writes. ``setup.json`` at its top may
say which square of the pictures the networks see and which clips belong to which split:

    {"crop": [125, 0, 475], "splits": {"validation": ["clip3"], "test": ["clip4"]}}

Clips that it does not name are for training; without it, clips are split by the order of names.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from pydantic import BaseModel, ConfigDict, Field
from torch.utils.data import IterableDataset

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.errors import FootageError
from rollcast.footage import SquareCrop, read_images
from rollcast.tracking.tracks import Tracks
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from rollcast.video import every_frame
from training.common.distributed import Share
from training.common.settings import runs_folder
from training.data.rest_height_map import MAP_CELLS
from training.data.splits import Split
from training.data.windows import Batch, SceneTargets, Symmetry, Window, collate

SETUP_FILE = "setup.json"
VIDEOS = (".mp4", ".webm", ".mov", ".avi", ".mkv")
UNSEEN: Mapping[Split, float] = {"validation": 0.15, "test": 0.15}
"""Shares of the clips that training does not see, where nobody says which."""
EVERY = 5
"""Frames between the windows of a clip that figures are of."""
LIGHT = 0.05
"""Standard deviation of the factors by which training brightens each colour of a window: light
and cameras' settings change from clip to clip."""
MISSED_FRAME = 1.5
"""Times between frames, in multiples of the usual one, from which one is missing."""


class Setup(BaseModel):
    """What ``setup.json`` says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    crop: Annotated[tuple[int, int, int], Field(description="x, y, size in pixels")] | None = None
    splits: Mapping[Split, tuple[str, ...]] | None = None


@dataclass(frozen=True)
class Clip:
    """A clip as networks see it.

    Attributes
    ----------
    positions
        128-px units; NaN in gaps.
    missed
        Whether the camera missed frames right before each one.
    """

    name: str
    frames: UInt8[np.ndarray, "frames 128 128 3"]
    positions: Float[np.ndarray, "balls frames 2"]
    missed: np.ndarray
    frame_rate: float
    crop: SquareCrop
    """What the frames show of the camera's pictures."""
    colors: tuple[str, ...]
    """Of each ball."""


class Place(NamedTuple):
    """Where a window begins."""

    clip: int
    start: int


class Clips:
    """Clips of one split, and the windows that can be cut out of them.

    Windows never reach over a gap in a ball's track, nor over missed frames.

    Parameters
    ----------
    balls
        Numbers of the balls that windows are about, in the order of the network's; None for all.
    """

    def __init__(self, clips: Sequence[Clip], balls: Sequence[int] | None = None) -> None:
        self.clips = clips
        self._balls = list(range(len(clips[0].positions))) if balls is None else list(balls)

    @property
    def objects(self) -> int:
        """Balls of every window."""
        return len(self._balls)

    @property
    def colors(self) -> tuple[str, ...]:
        """Of each ball of the windows, in the first clip."""
        return tuple(self.clips[0].colors[ball] for ball in self._balls)

    def places(self, horizon: int, every: int = 1) -> list[Place]:
        """Return where windows with ``horizon`` steps may begin, every so many frames."""
        length = FIRST_FORECAST_FRAME + horizon
        found: list[Place] = []
        for index, clip in enumerate(self.clips):
            known = np.asarray(np.isfinite(clip.positions[self._balls]).all(axis=(0, 2)))
            # A window may begin where frames were missed, and not go on there.
            ended = 0
            for frame, is_known in enumerate(known.tolist()):
                if not is_known:
                    ended = frame + 1
                elif clip.missed[frame]:
                    ended = frame
                first = frame - length + 1
                if first >= ended and (first - ended) % every == 0:
                    found.append(Place(index, first))
        return found

    def window(self, place: Place, horizon: int, *, scene_targets: bool = False) -> Window:
        """Cut the window that begins at a place; its angular velocities are not known."""
        clip = self.clips[place.clip]
        last = place.start + FIRST_FORECAST_FRAME + horizon
        tracked = clip.positions[self._balls, place.start : last]
        steps = tracked[:, FIRST_FORECAST_FRAME:]
        return Window(
            np.asarray(clip.frames[place.start : place.start + OBSERVED_FRAMES]),
            steps,
            np.full((*steps.shape[:2], 3), np.nan),
            _scene_targets(tracked) if scene_targets else None,
        )

    def history(self, place: Place, frames: int) -> Float[np.ndarray, "balls frames 2"]:
        """Positions from a window's first frame on."""
        clip = self.clips[place.clip]
        return clip.positions[self._balls, place.start : place.start + frames]


class ClipStream(IterableDataset[Batch]):
    """Endless batches of windows, turned and mirrored; batch k depends on the seed and k alone.

    The same interface as :class:`training.data.windows.TrainingStream`.
    """

    def __init__(
        self,
        clips: Clips,
        horizon: int,
        batch_size: int,
        seed: int,
        first_batch: int,
        *,
        scene_targets: bool = False,
        share: Share | None = None,
    ) -> None:
        self._clips = clips
        self._horizon = horizon
        self._places = clips.places(horizon)
        if not self._places:
            raise FootageError(
                f"no clip shows all balls for {FIRST_FORECAST_FRAME + horizon} frames on end"
            )
        self._batch_size = batch_size
        self._seed = seed
        self._first_batch = first_batch
        self._scene_targets = scene_targets
        self._share = share or Share()

    def __iter__(self) -> Iterator[Batch]:
        """Batches from ``first_batch`` on."""
        worker = torch.utils.data.get_worker_info()
        first, stride = (0, 1) if worker is None else (worker.id, worker.num_workers)
        number = self._first_batch + first
        while True:
            generator = np.random.default_rng([self._seed, number])
            rows = generator.integers(len(self._places), size=self._batch_size)
            turns = generator.integers(4, size=self._batch_size)
            mirrors = generator.integers(2, size=self._batch_size)
            lights = 1 + LIGHT * generator.standard_normal((self._batch_size, 3))
            yield collate(
                [
                    Symmetry(int(turns[row]), bool(mirrors[row])).apply(
                        _in_other_light(self._window(rows[row]), lights[row])
                    )
                    for row in self._share.of(self._batch_size)
                ]
            )
            number += stride

    def _window(self, row: int) -> Window:
        return self._clips.window(
            self._places[row], self._horizon, scene_targets=self._scene_targets
        )


def load_clips(folder: Path) -> dict[Split, list[Clip]]:
    """Read the clips of a folder by split; their frames are kept small beside the runs.

    Raises
    ------
    FootageError
        When there are no clips with tracks, they do not belong together, or one cannot be read.
    """
    tracked = {path.stem: path for path in sorted(folder.rglob("*.parquet"))}
    if not tracked:
        raise FootageError(
            f"{folder} holds no tracks (NAME.parquet beside NAME.mp4): run `rollcast track` first"
        )
    file = folder / SETUP_FILE
    setup = Setup.model_validate_json(file.read_bytes()) if file.exists() else Setup()
    crop = None if setup.crop is None else SquareCrop(*setup.crop)
    clips = {name: _clip(path, crop) for name, path in tracked.items()}
    counts = {name: len(clip.positions) for name, clip in clips.items()}
    if len(set(counts.values())) > 1:
        raise FootageError(f"clips of one folder show equally many balls, these differ: {counts}")
    splits = _splits(list(clips), setup)
    return {
        split: [clips[name] for name in names if name in clips] for split, names in splits.items()
    }


def _splits(names: Sequence[str], setup: Setup) -> dict[Split, list[str]]:
    if setup.splits is not None:
        named: dict[Split, list[str]] = {
            split: list(setup.splits.get(split, ())) for split in UNSEEN
        }
        unknown = {name for of in setup.splits.values() for name in of} - set(names)
        if unknown:
            raise FootageError(f"{SETUP_FILE} names clips without tracks: {', '.join(unknown)}")
        taken = {name for of in named.values() for name in of}
        return {"training": [name for name in names if name not in taken], **named}
    unseen = {split: max(1, round(share * len(names))) for split, share in UNSEEN.items()}
    # By a hash, so that a clip more leaves the others nearly as they were.
    mixed = sorted(names, key=lambda name: hashlib.sha256(name.encode()).digest())
    first, second = unseen["validation"], unseen["validation"] + unseen["test"]
    if len(names) <= second:
        raise FootageError(
            f"{len(names)} clips cannot be split into training, validation and test; name the "
            f"splits in {SETUP_FILE}, where a clip may be in two of them"
        )
    return {
        "training": mixed[second:],
        "validation": mixed[:first],
        "test": mixed[first:second],
    }


def _clip(path: Path, crop: SquareCrop | None) -> Clip:
    tracks = Tracks.read(path)
    source = _source(path)
    crop = crop or SquareCrop.centred(tracks.width, tracks.height)
    frames = _small_frames(source, crop)
    if len(frames) != len(tracks.times_s):
        raise FootageError(
            f"{source} has {len(frames)} frames, its tracks in {path} have {len(tracks.times_s)}"
        )
    positions = (tracks.positions_px - (crop.x, crop.y)) * (NETWORK_FRAME_SIZE / crop.size)
    spans = np.diff(tracks.times_s)
    usual = float(np.median(spans))
    return Clip(
        path.stem,
        frames,
        positions.swapaxes(0, 1),
        np.concatenate([[False], spans > MISSED_FRAME * usual]),
        1 / usual,
        crop,
        tracks.colours,
    )


def _source(tracks: Path) -> Path:
    """Return the video or the folder of images that tracks lie beside."""
    folder = tracks.with_suffix("")
    if folder.is_dir():
        return folder
    for suffix in VIDEOS:
        if (video := tracks.with_suffix(suffix)).exists():
            return video
    raise FootageError(
        f"{tracks} has no clip beside it: expected {tracks.stem}{VIDEOS[0]} (or "
        f"{', '.join(VIDEOS[1:])}) or a folder {tracks.stem}/ of images"
    )


def _small_frames(source: Path, crop: SquareCrop) -> UInt8[np.ndarray, "frames 128 128 3"]:
    """Frames of 128 x 128 pixels, kept in a file so that a clip is decoded once."""
    changed = source.stat().st_mtime_ns
    key = hashlib.sha256(f"{source.resolve()} {changed} {crop}".encode()).hexdigest()[:16]
    kept = runs_folder() / "data" / "clips" / f"{key}.npy"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        small = [
            cv2.resize(picture, (NETWORK_FRAME_SIZE,) * 2, interpolation=cv2.INTER_AREA)
            for picture in _squares(source, crop)
        ]
        unfinished = kept.with_suffix(".tmp.npy")
        np.save(unfinished, np.stack(small))
        unfinished.replace(kept)
    return np.load(kept, mmap_mode="r")


def _squares(source: Path, crop: SquareCrop) -> Iterator[UInt8[np.ndarray, "S S 3"]]:
    if source.is_dir():
        yield from read_images(sorted(source.iterdir()), crop=crop).frames
    else:
        for moment in every_frame(source):
            yield crop.cut(moment.picture)


def _in_other_light(window: Window, factors: Float[np.ndarray, "3"]) -> Window:
    """Brighten the frames of a window, all of them alike."""
    brightened = (window.frames * factors.astype(np.float32)).clip(0, 255)
    return window._replace(frames=brightened.round().astype(np.uint8))


def _scene_targets(positions: Float[np.ndarray, "balls frames 2"]) -> SceneTargets:
    """Return what tracks tell of the scene: centres as seen from above; NaN where unknown."""
    heights = np.full((*positions.shape[:2], 1), np.nan)
    centres = np.concatenate([positions * (2 / NETWORK_FRAME_SIZE) - 1, heights], axis=-1)
    unknown = np.full((3, MAP_CELLS, MAP_CELLS), np.nan)
    return SceneTargets(centres, unknown, np.full(2, np.nan))
