"""``rollcast track`` from a shell's point of view."""

import json
import os

import numpy as np
import pytest

from rollcast.__main__ import main
from rollcast.tracking.tracks import Tracks
from rollcast.video import every_frame
from tests.e2e.conftest import serving
from tests.rollcast.tracking.billiards import billiards


@pytest.fixture(scope="module", autouse=True)
def service():
    """A real service, which the commands ask by the environment's address."""
    with serving() as address, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROLLCAST_URL", address)
        yield


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    return [billiards(2, 60, seed).record(folder / f"clip{seed}.mp4") for seed in (1, 2)]


def test_clips_get_tracks_a_report_and_a_video_each(clips, tmp_path, capsys):
    out = tmp_path / "new" / "tracks"
    assert main(["track", *map(str, clips), "--balls", "2", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    for clip in clips:
        tracks = Tracks.read(out / f"{clip.stem}.parquet")
        assert (tracks.clip, tracks.balls) == (clip.stem, 2)
        report = json.loads((out / f"{clip.stem}.json").read_text())
        assert report["frames"] == 60
        assert sum(1 for _ in every_frame(out / "videos" / f"{clip.stem}.mp4")) == 60
        assert f"{clip.stem}: 60 frames, 2.0 s, {100 * report['found']:.1f} %" in said


def test_tracks_are_written_as_csv(clips, tmp_path, capsys):
    assert (
        main(["track", str(clips[0]), "--out", str(tmp_path), "--format", "csv", "--no-video"]) == 0
    )
    rows = np.genfromtxt(tmp_path / "clip1.csv", delimiter=",", names=True, skip_header=1)
    assert len(rows) == 2 * 60
    tracks = Tracks.read(tmp_path / "clip1.csv")
    np.testing.assert_array_equal(tracks.positions_px[..., 0].ravel(), rows["x"])
    assert not (tmp_path / "videos").exists()


def test_a_terminal_names_the_stage_of_how_many(clips, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes any stream for a terminal
    assert main(["track", *map(str, clips), "--balls", "2", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().err
    stages = ("tracking clip1", "drawing clip1", "tracking clip2", "drawing clip2")
    for number, what in enumerate(stages, 1):
        assert f"{number} of 4: {what}" in shown


def test_clips_of_one_name_in_two_folders_are_kept_apart(clips, tmp_path, capsys):
    days = [tmp_path / "rig" / day for day in ("mon", "tue")]
    for day, clip in zip(days, clips, strict=True):
        day.mkdir(parents=True)
        (day / "CLIP.MP4").write_bytes(clip.read_bytes())
    named = [str(day / "CLIP.MP4") for day in days]
    out = tmp_path / "rig"
    assert main(["track", *named, "--balls", "2", "--out", str(out)]) == 0
    tracks = [Tracks.read(day / "CLIP.parquet") for day in days]
    assert [one.clip for one in tracks] == ["mon/CLIP", "tue/CLIP"]
    assert not np.allclose(*(one.positions_px for one in tracks), equal_nan=True)
    assert (out / "videos/tue/CLIP.mp4").exists()
    # The same clip may be tracked again, another one of its name does not replace it.
    capsys.readouterr()
    (days[0] / "CLIP.MP4").write_bytes((days[1] / "CLIP.MP4").read_bytes())
    assert main(["track", named[0], "--out", str(days[0])]) == 1
    assert "holds the tracks of another clip" in capsys.readouterr().err


def test_images_are_tracked_at_the_rate_that_is_named(tmp_path, capsys):
    folder = tmp_path / os.fsdecode(b"clip\xff")
    folder.mkdir()
    made = billiards(2, 60, 1)
    for index in range(60):
        made.picture(index).save(folder / f"{index}.png")
    arguments = ["track", str(folder), "--balls", "2", "--out", str(tmp_path)]
    assert main(arguments) == 1
    assert "pass their --rate" in capsys.readouterr().err
    assert main([*arguments, "--rate", "30"]) == 0
    assert r"clip\xff: 60 frames, 2.0 s" in capsys.readouterr().out
    tracks = Tracks.read(tmp_path / os.fsdecode(b"clip\xff.parquet"))
    np.testing.assert_allclose(tracks.times_s, np.arange(60) / 30)


@pytest.mark.parametrize(
    ("arguments", "code", "reason"),
    [
        (["missing.mp4"], 1, "missing.mp4 cannot be read: No such file or directory"),
        (["here/a.mp4", "here/a.mov"], 1, "two clips are called a; rename one of them"),
        (["a.mp4", "--balls", "9"], 2, "9 is not a whole number from 1 to 8"),
        (["a.mp4", "--crop", "1,2"], 2, "1,2 is not X,Y,SIZE"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, code, reason, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["track", *arguments]) == code
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
