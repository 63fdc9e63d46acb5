"""What training frames look like, fitted to simulated scenes, and how it gets into an artefact."""

import shutil

import numpy as np
import pytest

from rollcast.manifest import MANIFEST_FILE, OOD_FILE, PERCEPTION_FILE, Manifest
from rollcast.ood import frame_stats
from tests.training.conftest import HEMISPHERE, SCENES
from tests.training.export.test_export import ROOT
from training.data.shards import load_recordings, simulate_split
from training.data.windows import WindowMaker
from training.export import ood_fit
from training.export.export import hashes
from training.export.ood_fit import (
    FALSE_ALARMS,
    PLACED_A_SCENE,
    calibrate_threshold,
    fit,
    fit_place_uncertainties,
    keep,
    source_frame_stats,
)


@pytest.fixture(scope="module")
def known(runs):
    """Frame statistics of hemispheres: those to fit to, and others."""
    return [
        source_frame_stats(HEMISPHERE, split, SCENES, 1) for split in ("training", "validation")
    ]


@pytest.fixture(scope="module")
def ood_detector(known):
    return fit([known[0]])


def test_what_it_was_fitted_to_has_scores_about_one(ood_detector, known):
    squares = [ood_detector.score(one) ** 2 for one in known[0]]
    # The mean square of whitened numbers is 1 by definition, but for the one of n that cov takes.
    assert np.mean(squares) == pytest.approx(1, rel=0.01)


def test_the_threshold_leaves_the_wanted_share_above_it(ood_detector, known):
    calibrated = calibrate_threshold(ood_detector, known[1], known[1])
    assert calibrated.false_alarm_rate == pytest.approx(FALSE_ALARMS, abs=1 / len(known[1]))
    assert calibrated.test_windows == len(known[1])


def test_other_pictures_are_out_of_distribution(ood_detector, known, runs):
    threshold = calibrate_threshold(ood_detector, *known[::-1]).threshold
    recordings = load_recordings(simulate_split(HEMISPHERE, "validation", SCENES, 1))
    frames = WindowMaker(recordings, final_step=None).window(0, 80, 1).frames
    noise = np.random.default_rng(0).normal(0, 40, frames.shape)
    others = {
        "itself": frames,
        "a larger cut": np.pad(frames[:, ::2, ::2], ((0, 0), (32, 32), (32, 32), (0, 0))),
        "a smaller cut": frames[:, 32:96, 32:96].repeat(2, axis=1).repeat(2, axis=2),
        "noise": (frames + noise).clip(0, 255).astype(np.uint8),
        "a moving camera": np.stack([np.roll(f, 6 * k, axis=1) for k, f in enumerate(frames)]),
        "nothing": np.zeros_like(frames),
    }
    found = {
        name: ood_detector.score(frame_stats(other)) > threshold for name, other in others.items()
    }
    assert found == {name: name != "itself" for name in others}


def test_an_artefact_keeps_it(ood_detector, known, tmp_path):
    folder = shutil.copytree(ROOT / "models" / "posnet" / "1", tmp_path / "posnet" / "1")
    ood = calibrate_threshold(ood_detector, known[0], known[1])
    manifest = keep(ood_detector, ood, folder)
    assert Manifest.read(folder / MANIFEST_FILE) == manifest
    assert manifest.ood == ood
    assert manifest.files == hashes(folder)
    assert {PERCEPTION_FILE, OOD_FILE} <= set(manifest.files)


def test_balls_are_lost_where_their_place_is_less_certain_than_in_known_scenes(
    tmp_path, monkeypatch
):
    # Fewer scenes than the other tests', so not in their folder.
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path / "runs"))
    monkeypatch.setattr(ood_fit, "_sources", lambda *_: [HEMISPHERE])
    folder = shutil.copytree(ROOT / "models" / "fieldnet" / "1", tmp_path / "fieldnet" / "1")
    posnet = shutil.copytree(ROOT / "models" / "posnet" / "1", tmp_path / "posnet" / "1")
    (manifest,) = fit_place_uncertainties([folder, posnet], 4, 1)
    assert Manifest.read(folder / MANIFEST_FILE) == manifest
    known = manifest.place_uncertainty
    assert known is not None
    assert known.test_windows >= 4 * PLACED_A_SCENE
    # Balls of some 12 px are placed to fractions of a pixel, and nearly all of them are found.
    assert 0.5 <= known.threshold_px < 1
    assert known.false_alarm_rate <= 4 / known.test_windows
