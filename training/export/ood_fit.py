"""Fit of the two thresholds of out-of-distribution frames.

They are an out-of-distribution score of the frames (decision 0120), and the standard deviation of
a ball's place at t = 0 (decision 0145).
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from rollcast.manifest import (
    MANIFEST_FILE,
    OOD_FILE,
    Manifest,
    OodThreshold,
    PlaceUncertainty,
)
from rollcast.ood import FrameStats, OodDetector, frame_stats, summed_up
from rollcast.scene import SMALL_RADIUS_M, Scenario
from training.data.clip_dataset import Clips
from training.data.shards import Source, load_recordings, simulate_split
from training.data.splits import Split
from training.data.windows import Symmetry, Window, WindowMaker, fixed_windows
from training.export.export import hashes
from training.export.load import load_exported
from training.networks.recurrent import Family
from training.objectives.metrics import forecast

COMPONENTS = 24
LATEST_START = 140
"""Last frame of a simulation at which a window may begin, as in training."""
WINDOWS_A_SCENE = 24
LOST_ALARMS = 0.02
"""Share of the validation windows in which a ball counts as lost: a wrong alarm costs little, since
the model for out-of-distribution frames finds these balls, too."""
FOUND_PX = 0.5
"""Minimum threshold of the standard deviation of a position."""
PLACED_A_SCENE = 4
"""Windows of a scene in which a network places the balls, for the threshold of its certainty."""
CLIP_FRAMES_BETWEEN = 3
LEAST_VARIANCE = 1e-6
"""Minimum variance relative to the largest: some numbers do not vary over few windows."""
FALSE_ALARMS = 0.005
"""Share of the validation windows that the threshold leaves above it."""
OOD_SCENES = 100
"""Number of windows of the training split, and of the validation split."""
TEST_SCENES = 500
SEED = 120


def fit_ood_detectors(folders: Sequence[Path], scenes: int, workers: int) -> list[Manifest]:
    """Fit the statistics of the training frames and write them into artefacts.

    Artefacts for the same scenarios and number of balls get the same file.

    Parameters
    ----------
    folders
        ``models/NAME/VERSION``.
    scenes
        Of the training split to fit to and of the validation split for the threshold, a kind.
    """
    kinds: dict[tuple[tuple[Scenario, ...], int], list[Path]] = {}
    for folder in folders:
        manifest = Manifest.read(folder / MANIFEST_FILE)
        kinds.setdefault((manifest.simulated, manifest.objects), []).append(folder)
    written: list[Manifest] = []
    for kind, alike in sorted(kinds.items()):
        sources = _sources(*kind)
        ood_detector = fit(
            [source_frame_stats(source, "training", scenes, workers) for source in sources]
        )
        known = [
            one for s in sources for one in source_frame_stats(s, "validation", scenes, workers)
        ]
        fresh = [one for s in sources for one in fixed_frame_stats(s, workers)]
        ood = calibrate_threshold(ood_detector, known, fresh)
        written += [keep(ood_detector, ood, folder) for folder in alike]
    return written


def _sources(scenarios: Sequence[Scenario], objects: int) -> list[Source]:
    """Return the kinds of scenes that models for some scenarios are trained on."""
    sources = [Source(scenario, objects) for scenario in scenarios]
    if objects == 1:  # some of a training's balls are small (training/recipes)
        sources += [Source(s, objects, SMALL_RADIUS_M) for s in scenarios if s != "heightfield"]
    return sources


def calibrate_threshold(
    ood_detector: OodDetector, known: Sequence[FrameStats], fresh: Sequence[FrameStats]
) -> OodThreshold:
    """Choose the threshold on known frames; count how often fresh ones exceed it."""
    scores = [ood_detector.score(one) for one in known]
    threshold = round(float(np.quantile(scores, 1 - FALSE_ALARMS)), 3)
    alarms = [ood_detector.score(one) > threshold for one in fresh]
    return OodThreshold(
        threshold=threshold,
        false_alarm_rate=round(float(np.mean(alarms)), 4),
        test_windows=len(fresh),
    )


def fit_clip_ood_detector(folder: Path, clips: Mapping[Split, Clips]) -> Manifest:
    """Fit the statistics of the training clips and write them into an artefact.

    Windows begin every few frames of the training clips, under any of the square's symmetries; the
    threshold is chosen on the validation clips, the false alarms are counted on the test clips.
    """
    fitted = fit([clip_frame_stats(clips["training"], symmetric=True)])
    known, fresh = (
        clip_frame_stats(clips[split], symmetric=False) for split in ("validation", "test")
    )
    return keep(fitted, calibrate_threshold(fitted, known, fresh), folder)


def keep(ood_detector: OodDetector, ood: OodThreshold, folder: Path) -> Manifest:
    """Write both into an artefact."""
    ood_detector.write(folder / OOD_FILE)
    manifest = Manifest.read(folder / MANIFEST_FILE)
    changes = {"ood": ood, "files": hashes(folder)}
    changed = Manifest.model_validate(dict(manifest) | changes)
    changed.write(folder / MANIFEST_FILE)
    return changed


def fit(by_source: Sequence[Sequence[FrameStats]]) -> OodDetector:
    """Fit a Gaussian to every source's frame statistics."""
    fitted = [_fit(seen) for seen in by_source]
    return OodDetector(*(np.stack(parts).astype(np.float32) for parts in zip(*fitted, strict=True)))


def _fit(seen: Sequence[FrameStats]) -> tuple[np.ndarray, ...]:
    """Return the fields of an OodDetector for one source."""
    thumbnails = np.stack([one.thumbnail for one in seen])
    thumbnail = thumbnails.mean(axis=0)
    components = np.linalg.svd(thumbnails - thumbnail, full_matrices=False)[2][:COMPONENTS]
    numbers = np.stack([summed_up(one, thumbnail, components) for one in seen]).astype(float)
    mean = numbers.mean(axis=0)
    variances, axes = np.linalg.eigh(np.cov(numbers.T))
    variances = variances.clip(min=LEAST_VARIANCE * variances[-1])
    return thumbnail, components, mean, (axes / np.sqrt(variances)).T


def fit_place_uncertainties(folders: Sequence[Path], scenes: int, workers: int) -> list[Manifest]:
    """Fit, and write into artefacts, from which uncertainty of its place a ball counts as lost.

    Artefacts without predicted covariances are left out, and quantised ones, which have that of
    their original.

    Parameters
    ----------
    folders
        ``models/NAME/VERSION`` of models for a fixed number of balls.
    scenes
        Of the validation split for the threshold and of the test split for the false alarms.
    """
    manifests = [Manifest.read(folder / MANIFEST_FILE) for folder in folders]
    return [
        _fit_place_uncertainty(folder, scenes, workers)
        for folder, manifest in zip(folders, manifests, strict=True)
        if manifest.covariance.source == "predicted" and "quantised" not in manifest.training
    ]


def _fit_place_uncertainty(folder: Path, scenes: int, workers: int) -> Manifest:
    manifest, network = load_exported(folder)
    family = Family({manifest.name: network})
    scale = (manifest.covariance.variance_scale or (1.0,))[0]
    sources = _sources(manifest.simulated, manifest.objects)

    def sigmas(split: Split) -> Float[np.ndarray, " windows"]:
        """Return the standard deviation at t = 0 of the least certain ball of every window."""
        found: list[np.ndarray] = []
        for source in sources:
            drawn = source_windows(
                source, split, scenes, workers, PLACED_A_SCENE, manifest.final_step
            )
            made = forecast(family, list(drawn), 1, torch.device("cpu"))[manifest.name]
            assert made.covariances is not None
            found.append(np.linalg.eigvalsh(scale * made.covariances[:, :, 0])[..., -1].max(axis=1))
        return np.sqrt(np.concatenate(found))

    usual = float(np.quantile(sigmas("validation"), 1 - LOST_ALARMS))
    threshold = round(max(usual, FOUND_PX), 3)
    fresh = sigmas("test")
    known = PlaceUncertainty(
        threshold_px=threshold,
        false_alarm_rate=round(float(np.mean(fresh > threshold)), 4),
        test_windows=len(fresh),
    )
    changed = Manifest.model_validate(dict(manifest) | {"place_uncertainty": known})
    changed.write(folder / MANIFEST_FILE)
    return changed


def source_frame_stats(source: Source, split: Split, scenes: int, workers: int) -> list[FrameStats]:
    """Look at windows that begin at any time, under any of the square's symmetries."""
    windows = source_windows(source, split, scenes, workers, WINDOWS_A_SCENE)
    return [frame_stats(window.frames) for window in windows]


def source_windows(
    source: Source,
    split: Split,
    scenes: int,
    workers: int,
    a_scene: int,
    final_step: int | None = None,
) -> Iterator[Window]:
    """Yield windows that begin at any time, under any of the square's symmetries.

    Parameters
    ----------
    a_scene
        Windows of every scene.
    """
    recordings = load_recordings(simulate_split(source, split, scenes, workers))
    maker = WindowMaker(recordings, final_step)
    generator = np.random.default_rng(SEED)
    for index in range(len(recordings)):
        for start in generator.integers(LATEST_START + 1, size=a_scene):
            symmetry = Symmetry(int(generator.integers(4)), bool(generator.integers(2)))
            yield symmetry.apply(maker.window(index, int(start), horizon=1))


def clip_frame_stats(clips: Clips, *, symmetric: bool) -> list[FrameStats]:
    """Look at windows that begin every few frames of clips."""
    generator = np.random.default_rng(SEED)
    seen: list[FrameStats] = []
    for place in clips.places(horizon=1, every=CLIP_FRAMES_BETWEEN):
        window = clips.window(place, horizon=1)
        if symmetric:
            turned = Symmetry(int(generator.integers(4)), bool(generator.integers(2)))
            window = turned.apply(window)
        seen.append(frame_stats(window.frames))
    return seen


def fixed_frame_stats(source: Source, workers: int) -> list[FrameStats]:
    """Look at the fixed windows of the test split."""
    recordings = load_recordings(simulate_split(source, "test", TEST_SCENES, workers))
    windows = fixed_windows(recordings, horizon=1, final_step=None)
    return [frame_stats(window.frames) for window in windows]
