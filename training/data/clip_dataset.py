"""Clips with tracks as training data: a user's own set-up, or Roll4Real (paper, section 5.3).

A folder holds clips, in any depth: ``NAME.mp4`` (or another video, or a folder ``NAME/`` of images)
beside ``NAME.parquet`` or ``NAME.csv``, the tracks that ``rollcast track`` writes. Clips of one
name in several folders are called by their paths, ``mon/NAME``. ``setup.json`` at its top may say
which square of the pictures the networks see and which clips belong to which split:

    {"crop": [125, 0, 475], "splits": {"validation": ["clip3"], "test": ["clip4"]}}

Clips that it does not name are for training; without it, clips are split by the order of names.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from pydantic import BaseModel, ConfigDict, Field

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.clip import open_clip
from rollcast.errors import FootageError
from rollcast.footage import SquareCrop
from rollcast.frames import read_file
from rollcast.image_sequence import ImageSequence, image_files, is_hidden
from rollcast.tracking.tracks import CSV, PARQUET, Tracks, is_csv_of_tracks
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.common.distributed import Share
from training.common.settings import runs_folder
from training.data.rest_height_map import MAP_CELLS
from training.data.seeded_stream import SeededStream
from training.data.splits import Split
from training.data.windows import Batch, SceneTargets, Symmetry, Window, collate

SETUP_FILE = "setup.json"
READER = 2
"""Version of how clips are read; frames that an older one kept are read again."""
UNSEEN: Mapping[Split, float] = {"validation": 0.15, "test": 0.15}
"""Shares of the clips in other splits than training, unless ``setup.json`` assigns them."""
EVERY = 5
"""Frames between the windows of a clip that figures are of."""
LIGHT = 0.05
"""Standard deviation of the factors by which training brightens each colour of a window: light
and cameras' settings change from clip to clip."""
ANY_RATE = 1.0
"""Rate at which clips are opened: the times are those of the tracks."""
MISSED_FRAME = 1.5
"""Times between frames, in multiples of the usual one, from which one is missing."""


class Setup(BaseModel):
    """Content of ``setup.json``."""

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
    """Crop of the camera's pictures in the frames."""
    colors: tuple[str, ...]
    """Color of each ball."""


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


class ClipStream(SeededStream[Batch]):
    """Endless batches of windows of clips, turned and mirrored."""

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
        super().__init__(seed, first_batch)
        self._clips = clips
        self._horizon = horizon
        self._places = clips.places(horizon)
        if not self._places:
            raise FootageError(
                f"no clip shows all balls for {FIRST_FORECAST_FRAME + horizon} frames on end"
            )
        self._batch_size = batch_size
        self._scene_targets = scene_targets
        self._share = share or Share()

    def _batch(self, generator: np.random.Generator, number: int) -> Batch:  # noqa: ARG002 - the base's
        rows = generator.integers(len(self._places), size=self._batch_size)
        turns = generator.integers(4, size=self._batch_size)
        mirrors = generator.integers(2, size=self._batch_size)
        lights = 1 + LIGHT * generator.standard_normal((self._batch_size, 3))
        return collate(
            [
                Symmetry(int(turns[row]), bool(mirrors[row])).apply(
                    _in_other_light(self._window(rows[row]), lights[row])
                )
                for row in self._share.of(self._batch_size)
            ]
        )

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
    tracked = _tracked(folder)
    if not tracked:
        raise FootageError(
            f"{folder} holds no tracks (NAME.parquet or NAME.csv beside NAME.mp4): run "
            "`rollcast track` first"
        )
    setup = _setup(folder / SETUP_FILE)
    crop = None if setup.crop is None else SquareCrop(*setup.crop)
    clips = {name: _clip(path, crop, name) for name, path in tracked.items()}
    counts = {name: len(clip.positions) for name, clip in clips.items()}
    if len(set(counts.values())) > 1:
        raise FootageError(f"clips of one folder show equally many balls, these differ: {counts}")
    splits = _splits(list(clips), setup)
    return {
        split: [clips[name] for name in names if name in clips] for split, names in splits.items()
    }


def _tracked(folder: Path) -> dict[str, Path]:
    """Return the tracks in a folder by the names of their clips, which are all different."""
    found = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in (PARQUET, CSV)
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and (path.suffix.lower() == PARQUET or is_csv_of_tracks(path))
    ]
    clips = Counter(path.with_suffix("") for path in found)
    if twice := [clip for clip, count in clips.items() if count > 1]:
        raise FootageError(
            f"{twice[0]} has tracks in {PARQUET} and in {CSV}: remove one of the two files"
        )
    often = Counter(path.stem for path in found)
    return {
        path.stem
        if often[path.stem] == 1
        else path.relative_to(folder).with_suffix("").as_posix(): path
        for path in found
    }


def _setup(file: Path) -> Setup:
    if not file.exists():
        return Setup()
    try:
        return Setup.model_validate_json(read_file(file).decode("utf-8-sig"))
    except (OSError, ValueError) as error:  # pydantic's, and of bytes that are not UTF-8
        raise FootageError(f"{file} cannot be read: {error}") from error


def _splits(names: Sequence[str], setup: Setup) -> dict[Split, list[str]]:
    if setup.splits is not None:
        named: dict[Split, list[str]] = {
            split: list(setup.splits.get(split, ())) for split in UNSEEN
        }
        unknown = {name for of in setup.splits.values() for name in of} - set(names)
        if unknown:
            alike = [name for name in names if name.rpartition("/")[2] in unknown]
            hint = f"; write which one: {', '.join(alike)}" if alike else ""
            raise FootageError(
                f"{SETUP_FILE} names clips without tracks: {', '.join(sorted(unknown))}{hint}"
            )
        taken = {name for of in named.values() for name in of}
        return {"training": [name for name in names if name not in taken], **named}
    unseen = {split: max(1, round(share * len(names))) for split, share in UNSEEN.items()}
    # By a hash, so that a clip more leaves the others nearly as they were.
    mixed = sorted(names, key=lambda name: hashlib.sha256(os.fsencode(name)).digest())
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


def _clip(path: Path, crop: SquareCrop | None, name: str) -> Clip:
    tracks = Tracks.read(path)
    source = _source(path, (tracks.width, tracks.height))
    crop = crop or SquareCrop.centred(tracks.width, tracks.height)
    every_frame = _small_frames(source, crop)
    if len(every_frame) <= tracks.frames[-1]:
        raise FootageError(
            f"{source} has {len(every_frame)} frames, its tracks in {path} reach to frame "
            f"{tracks.frames[-1]}"
        )
    whole = len(every_frame) == len(tracks.frames)
    frames = every_frame if whole else every_frame[tracks.frames]
    positions = (tracks.positions_px - (crop.x, crop.y)) * (NETWORK_FRAME_SIZE / crop.size)
    spans = np.diff(tracks.times_s)
    usual = float(np.median(spans))
    missed = np.concatenate(
        [[False], (spans > MISSED_FRAME * usual) | _gaps(source, tracks.frames)]
    )
    return Clip(
        name,
        frames,
        positions.swapaxes(0, 1),
        missed,
        1 / usual,
        crop,
        tracks.colors,
    )


def _source(tracks: Path, size: tuple[int, int]) -> Path:
    """Return the clip that tracks lie beside: a folder of images, or a video by its content.

    Of several videos of one name (cameras write small copies) it is the one with the
    size of the tracked pictures.
    """
    folder = tracks.with_suffix("")
    if folder.is_dir() and image_files(folder):
        return folder
    beside = [
        path
        for path in sorted(tracks.parent.iterdir())
        if path.stem == tracks.stem and path != tracks and path.is_file() and not is_hidden(path)
    ]
    sizes = {path: found for path in beside if (found := _size(path)) is not None}
    fitting = [path for path, found in sizes.items() if found == size] or list(sizes)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise FootageError(
            f"{tracks} has several clips beside it: {', '.join(path.name for path in fitting)}; "
            "leave one of them there"
        )
    raise FootageError(
        f"{tracks} has no clip beside it: expected a video {tracks.stem}.mp4 (of any kind) or a "
        f"folder {tracks.stem}/ of images"
    )


def _size(path: Path) -> tuple[int, int] | None:
    """Return the width and height of a clip's pictures; None of a file that is no clip."""
    try:
        first, _ = islice(open_clip(path, rate=ANY_RATE).frames(), 2)
        height, width = first.load().shape[:2]
    except (FootageError, ValueError):
        return None
    return width, height


def _gaps(source: Path, frames: np.ndarray) -> np.ndarray:
    """Whether images are missing from the numbering, between each tracked one and the next."""
    if not source.is_dir():
        return np.array(False)
    numbers = np.array(ImageSequence.from_folder(source, ANY_RATE).numbers)[frames]
    return np.diff(numbers) > np.diff(frames)


def _small_frames(source: Path, crop: SquareCrop) -> UInt8[np.ndarray, "frames 128 128 3"]:
    """Frames of 128 x 128 pixels, kept in a file so that a clip is decoded once."""
    files = image_files(source) if source.is_dir() else [source]
    stamps = [f"{path.name} {(told := path.stat()).st_size} {told.st_mtime_ns}" for path in files]
    known = f"{READER} {source.resolve()} {crop} {stamps}"
    key = hashlib.sha256(known.encode("utf-8", "surrogateescape")).hexdigest()[:16]
    kept = runs_folder() / "data" / "clips" / f"{key}.npy"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        small = [
            cv2.resize(
                crop.cut(taken.load()), (NETWORK_FRAME_SIZE,) * 2, interpolation=cv2.INTER_AREA
            )
            for taken in open_clip(source, rate=ANY_RATE).frames()
        ]
        unfinished = kept.with_suffix(".tmp.npy")
        np.save(unfinished, np.stack(small))
        unfinished.replace(kept)
    return np.load(kept, mmap_mode="r")


def _in_other_light(window: Window, factors: Float[np.ndarray, "3"]) -> Window:
    """Brighten the frames of a window, all of them alike."""
    brightened = (window.frames * factors.astype(np.float32)).clip(0, 255)
    return window._replace(frames=brightened.round().astype(np.uint8))


def _scene_targets(positions: Float[np.ndarray, "balls frames 2"]) -> SceneTargets:
    """Return the scene targets of tracks: centres in the image; unknown values are NaN."""
    heights = np.full((*positions.shape[:2], 1), np.nan)
    centres = np.concatenate([positions * (2 / NETWORK_FRAME_SIZE) - 1, heights], axis=-1)
    unknown = np.full((3, MAP_CELLS, MAP_CELLS), np.nan)
    return SceneTargets(centres, unknown, np.full(2, np.nan))
