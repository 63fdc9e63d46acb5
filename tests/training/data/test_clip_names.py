"""Folders of clips as recorders and file managers leave them: all are found, each with its own."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from rollcast.errors import FootageError
from tests.rollcast.tracking.billiards import billiards
from tests.training.data.test_clip_dataset import CROP, write_tracks
from training.data.clip_dataset import load_clips

FRAMES = 24


@pytest.fixture(autouse=True)
def _runs(tmp_path, monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path / "runs"))


def write_clip(folder: Path, name: str, seed: int, suffix: str = ".mp4") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    made = billiards(1, FRAMES, seed)
    write_tracks(folder / f"{name}.parquet", made.positions_px)
    if suffix == "/":
        (folder / name).mkdir()
        for index in range(FRAMES):
            made.picture(index).save(folder / name / f"{index}.png")
    else:
        made.record(folder / f"{name}.mp4").rename(folder / f"{name}{suffix}")


def all_clips(folder):
    return [clip for clips in load_clips(folder).values() for clip in clips]


def assert_balls_are_where_tracks_say(clips):
    """Frames that belong to other tracks, or come in another order, show no ball there."""
    for clip in clips:
        background = np.median(clip.frames, axis=0)
        for frame in range(0, FRAMES, 5):
            x, y = clip.positions[0, frame]
            if 4 < x < 124 and 4 < y < 124:
                assert np.abs(clip.frames[frame] - background).sum(axis=-1)[int(y), int(x)] > 60


@pytest.mark.parametrize("suffix", [".mp4", ".MP4", ".MTS", ".clip", "/"])
def test_clips_are_found_by_content_and_images_come_by_number(tmp_path, suffix):
    for seed in range(3):
        write_clip(tmp_path / "rig", f"c{seed}", seed, suffix)
    clips = all_clips(tmp_path / "rig")
    assert len(clips) == 3
    assert_balls_are_where_tracks_say(clips)


def test_clips_of_one_name_in_two_folders_are_kept_apart(tmp_path):
    rig = tmp_path / "rig"
    for seed, (day, name) in enumerate([("mon", "a"), ("mon", "b"), ("tue", "a"), ("tue", "c")]):
        write_clip(rig / day, name, seed)
    splits = {"validation": ["b"], "test": ["tue/a"]}
    (rig / "setup.json").write_text("\ufeff" + json.dumps({"crop": CROP, "splits": splits}))
    names = {split: [clip.name for clip in clips] for split, clips in load_clips(rig).items()}
    assert names == {"training": ["mon/a", "c"], "validation": ["b"], "test": ["tue/a"]}
    assert_balls_are_where_tracks_say(all_clips(rig))
    (rig / "setup.json").write_text(json.dumps({"splits": {"validation": ["a"], "test": ["b"]}}))
    with pytest.raises(FootageError, match="without tracks: a; write which one: mon/a, tue/a"):
        load_clips(rig)


def test_what_macos_leaves_behind_is_passed_over(tmp_path):
    rig = tmp_path / "rig"
    for seed in range(3):
        write_clip(rig, f"c{seed}", seed)
        (rig / f"._c{seed}.parquet").write_bytes(b"\0\5\x16\7")
        (rig / f"._c{seed}.mp4").write_bytes(b"\0\5\x16\7")
    (rig / ".DS_Store").write_bytes(b"\0\0\0\1Bud1")
    assert len(all_clips(rig)) == 3


def test_suffixes_names_and_empty_folders_of_recorders(tmp_path):
    rig = tmp_path / "rig"
    for seed, name in enumerate(["GX010001", "b", "c"]):
        write_clip(rig, name, seed, ".MP4")
    (rig / "GX010001").mkdir()
    (rig / "b.parquet").rename(rig / "b.PARQUET")
    for suffix in (".MP4", ".parquet"):
        (rig / f"c{suffix}").rename(rig / os.fsdecode(b"c\xff" + suffix.encode()))
    clips = all_clips(rig)
    assert len(clips) == 3
    assert_balls_are_where_tracks_say(clips)


def test_a_pipe_for_tracks_is_refused_at_once(tmp_path):
    write_clip(tmp_path / "rig", "c0", 0)
    os.mkfifo(tmp_path / "rig" / "x.parquet")
    with pytest.raises(FootageError, match=r"x\.parquet is a pipe"):
        load_clips(tmp_path / "rig")


def test_of_two_videos_of_one_name_the_tracked_one_is_taken(tmp_path):
    rig = tmp_path / "rig"
    for seed in range(3):
        write_clip(rig, f"c{seed}", seed)
    small = [billiards(1, FRAMES, 0).picture(index).resize((60, 45)) for index in range(FRAMES)]
    small[0].save(rig / "c0.LRV", "GIF", save_all=True, append_images=small[1:])
    assert_balls_are_where_tracks_say(all_clips(rig))
    (rig / "c0.mov").write_bytes((rig / "c0.mp4").read_bytes())
    with pytest.raises(FootageError, match=r"several clips beside it: c0\.mov, c0\.mp4"):
        load_clips(rig)


def test_windows_stop_at_a_gap_in_the_numbers(tmp_path):
    rig = tmp_path / "rig"
    for seed in range(3):
        write_clip(rig, f"c{seed}", seed, "/")
        for index in range(12, FRAMES):
            (rig / f"c{seed}" / f"{index}.png").rename(rig / f"c{seed}" / f"1{index}.png")
    for clip in all_clips(rig):
        assert np.flatnonzero(clip.missed).tolist() == [12]


@pytest.mark.parametrize("content", [b"{", b"\xff\xfe{}", b'{"crop": 3}'])
def test_a_setup_that_is_none_is_named(tmp_path, content):
    write_clip(tmp_path / "rig", "c0", 0)
    (tmp_path / "rig" / "setup.json").write_bytes(content)
    with pytest.raises(FootageError, match=r"setup\.json cannot be read"):
        load_clips(tmp_path / "rig")
