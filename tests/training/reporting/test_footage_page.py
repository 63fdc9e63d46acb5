"""The command that makes the page of real footage, on made-up clips."""

import numpy as np
import pytest
from typer.testing import CliRunner

from rollcast.tracking.tracks import Tracks
from tests.rollcast.tracking.billiards import RADIUS_PX, billiards
from training.cli import application
from training.data.clip_dataset import Clips, Setup
from training.recipes.setup import T_TRAIN
from training.reporting.footage_page import (
    FootageSource,
    Shot,
    of_one_clip,
    tracked,
    tracking_table,
)

FRAMES = 60


@pytest.fixture
def filmed(tmp_path, monkeypatch) -> FootageSource:
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path / "runs"))
    setup = Setup(crop=(30, 0, 180), splits={"test": ("clip",)})
    return FootageSource("table", {"clip.mp4": "a table"}, 2, setup)


def test_clips_are_tracked_once_into_a_folder_that_training_reads(filmed, tmp_path):
    made = billiards(2, FRAMES, seed=1)
    made.record(tmp_path / "clip.mp4")
    (report,) = tracked(tmp_path, filmed)
    assert report.frames == FRAMES
    tracks = Tracks.read(filmed.folder / "clip.parquet")
    apart = np.linalg.norm(tracks.positions_px - made.positions_px, axis=-1)
    assert np.nanmax(apart) < RADIUS_PX
    (tmp_path / "clip.mp4").unlink()
    assert tracked(tmp_path, filmed) == [report]
    found = f"{100 * report.found:.1f} %"
    assert f"| a table | {FRAMES} | {found} |" in tracking_table([("a table", report)])


def test_a_shot_is_the_part_of_a_clip_that_nobody_touches(filmed, tmp_path):
    billiards(2, FRAMES, seed=1).record(tmp_path / "clip.mp4")
    tracked(tmp_path, filmed)
    clip = Shot(filmed, ball=1, first=10, last=49).clip()
    assert len(clip.frames) == len(clip.missed) == 40
    assert clip.positions.shape == (2, 40, 2)
    assert [place.start for place in Clips([clip], [1]).places(T_TRAIN)][:2] == [0, 1]


def test_a_few_clips_train_up_to_the_compared_step_alone():
    assert of_one_clip("few").trained_horizon == T_TRAIN


def test_without_the_clips_it_is_skipped_with_a_line(tmp_path):
    said = CliRunner().invoke(application(), ["real", str(tmp_path)]).output
    assert said.startswith(f"skipped: {tmp_path} has no 4Ball-short1.mp4, ")
