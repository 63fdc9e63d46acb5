"""Exports a network that was trained on clips: the predictor of a user's own set-up."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from rollcast.manifest import CameraSetup, Manifest
from training.baselines.least_squares import POINTS, polynomial
from training.common.run_folder import read_best
from training.data.clip_dataset import EVERY, Clips
from training.data.splits import Split
from training.evaluation.evaluate import EvaluationSet
from training.export.export import export
from training.export.ood_fit import fit_clip_ood_detector
from training.export.spec import FootageSpec, Trained
from training.recipes.recipe import Recipe
from training.recipes.setup import T_GEN


def export_setup(
    recipe: Recipe,
    folder: Path,
    clips: Mapping[Split, Clips],
    models: Path,
    name: str,
    version: int,
) -> Manifest:
    """Write ``models/NAME/VERSION`` with the best weights of a run on clips.

    Parameters
    ----------
    folder
        Of the run.
    clips
        Clips of the training. Covariances are fitted on the validation clips, the card reports the
        test clips.

    Raises
    ------
    FileNotFoundError
        When the run has no weights yet.
    ValueError
        When torch and ONNX Runtime differ by more than the tolerance.
    """
    best = read_best(folder)
    (member,) = recipe.members
    (predictor,) = recipe.build().networks().values()
    predictor.load_state_dict(best["weights"][member.name])
    called = replace(recipe, members=(replace(member, name=name),))
    trained = Trained(
        called, name, predictor, best["sequences"], best["horizon"], _filmed(clips["training"])
    )
    to = models / name / str(version)
    sets = {split: [evaluation_set(clips[split], split)] for split in ("validation", "test")}
    export(trained, to, version, sets["validation"], sets["test"])
    return fit_clip_ood_detector(to, clips)


def evaluation_set(clips: Clips, split: Split) -> EvaluationSet:
    """Windows of the clips of a split up to T_gen, one every EVERY frames."""
    places = clips.places(T_GEN, EVERY)
    history = np.stack([clips.history(place, POINTS) for place in places])
    windows = [clips.window(place, T_GEN) for place in places]
    return EvaluationSet("footage", split, windows, polynomial(history, 1, T_GEN))


def _filmed(clips: Clips) -> FootageSpec:
    """Return the description of the footage of a model, from its first clip."""
    first = clips.clips[0]
    windows = {clip.name: 0 for clip in clips.clips}
    for place in clips.places(T_GEN):
        windows[clips.clips[place.clip].name] += 1
    crop = (first.crop.x, first.crop.y, first.crop.size)
    rate = float(np.median([clip.frame_rate for clip in clips.clips]))
    return FootageSpec(CameraSetup(colors=clips.colors, crop=crop), round(rate, 3), windows)
