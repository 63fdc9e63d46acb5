"""A folder of files that were once read wrongly: ``ROLLCAST_CASES=FOLDER pytest`` reads them all.

By default the folder is ``shared/cases/files`` beside the checkout. Files of the same kinds are
made in test_frames.py, test_video_kinds.py and test_clip_names.py; these here come from other
recorders and are not part of the repository.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from rollcast.__main__ import main
from rollcast.client import Client
from rollcast.client.images import decoded
from rollcast.client.testing import FakeService

ROOT = Path(__file__).parents[2]
CASES = os.environ.get("ROLLCAST_CASES")  # noqa: TID251 - where a tester keeps them
FOLDER = ROOT.parent / "shared/cases/files" if CASES is None else Path(CASES)
pytestmark = pytest.mark.skipif(
    CASES is None and not FOLDER.is_dir(), reason="ROLLCAST_CASES names no folder of cases"
)

READ = {
    "gray16png": ("", ()),
    "gray16tif": ("", ()),
    "floattif": ("", ()),
    "scene16": ("", ()),
    "rgba": ("", ()),
    "cmyk": ("", ()),
    "noeoi": ("", ()),
    "scenegap": ("2 images are missing from the numbering, after frame_0002.png", ()),
    "superscript": ("", ()),
    "macos": ("", ()),
    "scene_mirrored_tagged.mp4": ("", ()),
    "scene_slow_x3_stored.mp4": ("", ("--rate", "40")),
    "raw.h264": ("", ("--rate", "40")),
    "raw.mjpeg": ("", ("--rate", "40")),
    "tag709.mp4": ("", ()),
    "one_bad_packet.mp4": ("is damaged at 3.750 s", ("--start", "3.7")),
    "cover_first.mkv": ("", ()),
    "h264.avi": ("", ()),
    "interlaced.ts": ("is interlaced", ()),
}
"""What is warned of, and options, by name."""
REFUSED = {
    "raw.h264": ("holds no times", ()),
    "raw.mjpeg": ("holds no times", ()),
    "size_change.mkv": ("changes from 128 x 128 to 96 x 96", ("--start", "0.2")),
}


def predict(name, options, capsys):
    service = FakeService()
    code = main(
        ["predict", str(FOLDER / name), *options, "--horizon", "5"],
        lambda _: Client(transport=service),
    )
    return code, capsys.readouterr(), [request for request in service.requests if request.frames]


@pytest.mark.parametrize("name", READ)
def test_it_is_read(name, capsys):
    warning, options = READ[name]
    code, said, asked = predict(name, options, capsys)
    assert (code, said.err) == (0, "")
    assert "(40 a second)" in said.out
    assert warning in said.out
    frames = [decoded(frame) for frame in asked[0].frames]
    assert all(10 < frame.mean() < 250 for frame in frames), "neither black nor white"
    assert any((frame != frames[0]).any() for frame in frames[1:]), "the ball moves"


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_in_a_line(name, capsys):
    reason, options = REFUSED[name]
    code, said, asked = predict(name, options, capsys)
    assert (code, said.out, asked) == (1, "", [])
    assert reason in said.err
    assert said.err.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "clips"), [("images", 3), ("days", 6), ("upper", 3), ("apple", 3)]
)
def test_a_rig_is_found_with_its_own_tracks(name, clips, tmp_path, monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path))
    load_clips = pytest.importorskip("training.data.clip_dataset").load_clips  # needs torch
    found = [clip for split in load_clips(FOLDER / "rig" / name).values() for clip in split]
    assert len({clip.name for clip in found}) == clips
    for clip in found:
        unlike = np.abs(clip.frames - np.median(clip.frames, axis=0)).sum(axis=-1)
        for frame in range(0, len(clip.frames), 4):
            x, y = clip.positions[0, frame]
            assert unlike[frame, int(y), int(x)] > 60
