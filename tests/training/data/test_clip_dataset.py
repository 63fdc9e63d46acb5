"""Clips with tracks as training data, on a small made-up copy of the folder."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rollcast.errors import FootageError
from rollcast.tracking.tracks import Tracks
from tests.rollcast.tracking.billiards import COLORS, FRAME_RATE, HEIGHT, WIDTH, billiards
from training.cli.footage import setup_clips
from training.data.clip_dataset import Clips, ClipStream, Place, load_clips
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.recipes import RECIPES

FRAMES = 60
CROP = (30, 0, 180)


def write_tracks(path: Path, positions_px: np.ndarray) -> None:
    frames, balls = positions_px.shape[:2]
    missing = np.isnan(positions_px[..., 0])
    radii = np.where(missing, np.nan, 9.0)
    times = np.arange(frames) / FRAME_RATE
    colors = tuple("#{:02x}{:02x}{:02x}".format(*color) for color in COLORS[:balls])
    numbers = np.arange(frames)
    scores = 1.0 - missing
    Tracks(path.stem, WIDTH, HEIGHT, colors, numbers, times, positions_px, radii, scores).write(
        path
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Three videos and a folder of images, as in Roll4Real; the second ball has a gap in one."""
    top = tmp_path_factory.mktemp("PoolR")
    for seed in range(4):
        made = billiards(2, FRAMES, seed)
        positions = made.positions_px.copy()
        if seed == 0:
            positions[20:25, 1] = np.nan
        inside = top / f"day{seed % 2}"
        inside.mkdir(exist_ok=True)
        write_tracks(inside / f"clip{seed}.parquet", positions)
        if seed == 3:
            (inside / "clip3").mkdir()
            for index in range(FRAMES):
                made.picture(index).save(inside / "clip3" / f"{index:04}.png")
        else:
            made.record(inside / f"clip{seed}.mp4")
    splits = {"validation": ["clip2"], "test": ["clip3"]}
    (top / "setup.json").write_text(json.dumps({"crop": CROP, "splits": splits}))
    return top


@pytest.fixture(autouse=True)
def _runs(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path_factory.getbasetemp() / "runs"))


def test_clips_are_split_as_the_folder_says(folder):
    names = {split: [clip.name for clip in clips] for split, clips in load_clips(folder).items()}
    assert names == {"training": ["clip0", "clip1"], "validation": ["clip2"], "test": ["clip3"]}


def test_positions_are_where_the_small_frames_show_the_balls(folder):
    for clip in (one for clips in load_clips(folder).values() for one in clips):
        background = np.median(clip.frames, axis=0)
        for frame in (5, 30):
            unlike = np.abs(clip.frames[frame] - background).sum(axis=-1)
            for x, y in clip.positions[:, frame]:
                if 4 < x < 124 and 4 < y < 124:
                    assert unlike[int(y), int(x)] > 60


def test_windows_never_reach_over_a_gap(folder):
    clips = Clips(load_clips(folder)["training"][:1])
    horizon = 10
    starts = [place.start for place in clips.places(horizon)]
    length = 3 + horizon
    expected = [s for s in range(FRAMES - length + 1) if s + length <= 20 or s >= 25]
    assert starts == expected
    for start in starts:
        assert not np.isnan(clips.window(Place(0, start), horizon).positions).any()
    other = Clips(load_clips(folder)["training"][:1], balls=[0])
    assert len(other.places(horizon)) == FRAMES - length + 1


def test_windows_stop_where_frames_were_missed(folder):
    clip = load_clips(folder)["training"][1]
    clip.missed[30] = True
    starts = [place.start for place in Clips([clip]).places(10)]
    assert starts == [s for s in range(FRAMES - 12) if s + 13 <= 30 or s >= 30]


def test_a_window_begins_with_the_frame_before_the_forecast(folder):
    clips = Clips(load_clips(folder)["training"][1:], balls=[1])
    window = clips.window(Place(0, 7), horizon=5)
    clip = clips.clips[0]
    np.testing.assert_array_equal(window.frames, clip.frames[7:11])
    np.testing.assert_array_equal(window.positions[0], clip.positions[1, 10:15])
    np.testing.assert_array_equal(clips.history(Place(0, 7), 10)[0], clip.positions[1, 7:17])


def test_the_stream_resumes_anywhere_and_turns_frames_with_positions(folder):
    clips = Clips(load_clips(folder)["training"])
    first, second = (
        list(zip(range(3), ClipStream(clips, 5, 4, seed=1, first_batch=number), strict=False))
        for number in (0, 2)
    )
    for name in ("frames", "positions"):
        assert torch.equal(first[2][1][name], second[0][1][name])
    batch = first[0][1]
    for frames, positions in zip(batch["frames"], batch["positions"], strict=True):
        for ball, (x, y) in enumerate(positions[:, 0].tolist()):
            if not (6 < x < 122 and 6 < y < 122):
                continue
            seen = frames[3, int(y), int(x)].float()
            strange = COLORS[1 - ball]
            own = COLORS[ball]
            assert (seen - torch.tensor(own)).norm() < (seen - torch.tensor(strange)).norm()


def test_a_rig_is_trained_on_its_clips(folder, tmp_path):
    recipe = replace(RECIPES["setup-2-balls"](), sequences=32, batch_size=8)
    clips = setup_clips(recipe, folder, None)
    trainer = Trainer(
        recipe, tmp_path / "run", TrainerConfig(validate_every=2, workers=0), clips=clips
    )
    before = [p.detach().clone() for p in trainer.family.parameters()]
    assert np.isfinite(trainer.run())
    after = list(trainer.family.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(torch.isfinite(p).all() for p in after)


@pytest.mark.parametrize(
    ("recipe", "named", "balls", "reason"),
    [
        ("setup-2-balls", False, None, "pass their folder with --data"),
        ("field-one-ball", True, None, "--data is for the recipes setup-"),
        ("setup-3-balls", True, None, "setup-3-balls forecasts 3 of the clips' balls 0 to 1"),
        ("setup-one-ball", True, [2], "--balls selects 2"),
    ],
)
def test_recipes_clips_and_balls_have_to_fit(folder, recipe, named, balls, reason):
    with pytest.raises(FootageError, match=reason):
        setup_clips(RECIPES[recipe](), folder if named else None, balls)


def test_what_lies_wrong_in_a_folder_is_named(tmp_path):
    with pytest.raises(FootageError, match=r"holds no tracks \(NAME.parquet or NAME.csv"):
        load_clips(tmp_path)
    (tmp_path / "notes.csv").write_text("day,weather\nmonday,rain\n")
    with pytest.raises(FootageError, match="holds no tracks"):
        load_clips(tmp_path)
    write_tracks(tmp_path / "alone.parquet", billiards(2, FRAMES, 0).positions_px)
    with pytest.raises(FootageError, match=r"alone\.parquet has no clip beside it"):
        load_clips(tmp_path)
    billiards(2, FRAMES - 1, 0).record(tmp_path / "alone.mp4")
    with pytest.raises(FootageError, match=r"has 59 frames, its tracks in .* reach to frame 59"):
        load_clips(tmp_path)


def test_tracks_in_csv_files_are_those_in_parquet_files(folder, tmp_path):
    expected = {split: [*clips] for split, clips in load_clips(folder).items()}
    copy = tmp_path / "csv"
    shutil.copytree(folder, copy)
    for path in copy.rglob("*.parquet"):
        Tracks.read(path).write(path.with_suffix(".csv"))
        with pytest.raises(FootageError, match=r"tracks in \.parquet and in \.csv: remove one"):
            load_clips(copy)
        path.unlink()
    for split, clips in load_clips(copy).items():
        for clip, other in zip(clips, expected[split], strict=True):
            assert clip.name == other.name
            np.testing.assert_allclose(clip.positions, other.positions, atol=1e-9)
            np.testing.assert_array_equal(clip.frames, other.frames)
