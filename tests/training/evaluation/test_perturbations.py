"""Perturbed frames: what they show lies where the perturbation says, and the rest is as before."""

import numpy as np
import pytest

from training.evaluation.perturbations import PERTURBATIONS, PerturbationResult, results_table

BY_NAME = {one.name: one for one in PERTURBATIONS}
PLACES = np.array([[30.0, 50.0], [34.0, 52.0], [38.0, 54.0], [42.0, 56.0]])


def dots() -> np.ndarray:
    rows, columns = np.indices((128, 128)) + 0.5
    light = [np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18) for x, y in PLACES]
    return (40 + 200 * np.repeat(np.array(light)[..., None], 3, axis=-1)).astype(np.uint8)


def centre(frame: np.ndarray) -> np.ndarray:
    """Return the centre of the light near the middle of the paths."""
    weight = np.clip(frame.astype(float).mean(axis=-1) - 60, 0, None)
    weight[:, 80:] = 0
    rows, columns = np.indices(weight.shape) + 0.5
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("name", [name for name in BY_NAME if name.startswith("scale")])
def test_a_scaled_ball_lies_where_the_truth_is_moved(name):
    one = BY_NAME[name]
    changed = one.change(dots(), np.random.default_rng(0))
    for frame, place in zip(changed, PLACES, strict=True):
        np.testing.assert_allclose(centre(frame), one.move(place), atol=0.1)


@pytest.mark.parametrize("name", ["shake up to 0.5 px", "shake up to 1 px"])
def test_shake_moves_all_frames_but_the_last(name):
    reach = float(name.split()[-2])
    changed = BY_NAME[name].change(dots(), np.random.default_rng(1))
    np.testing.assert_array_equal(changed[-1], dots()[-1])
    away = np.array([centre(f) - p for f, p in zip(changed, PLACES, strict=True)])[:-1]
    assert 0.1 < np.abs(away).max() <= reach + 0.05


@pytest.mark.parametrize("name", [name for name in BY_NAME if "scale 0" not in name])
def test_every_perturbation_keeps_shape_and_type_and_changes_something(name):
    frames = dots()
    frames[..., 2] = frames[..., 2] // 2
    changed = BY_NAME[name].change(frames, np.random.default_rng(0))
    assert changed.shape == frames.shape
    assert changed.dtype == np.uint8
    assert np.array_equal(changed, frames) == (name == "none")


def test_the_ratio_is_the_mean_over_scenarios():
    def made(error: float, *inside: bool) -> PerturbationResult:
        return PerturbationResult(np.full(2, error), np.array(inside), np.array([True, False]))

    table = results_table(
        [
            ("none", {"hemisphere": made(1.0, True, True), "ellipsoid": made(4.0, True, True)}),
            ("dark", {"hemisphere": made(3.0, True, False), "ellipsoid": made(4.0, False, False)}),
        ]
    )
    assert table.splitlines()[-1] == "| dark | 3.0 | 4.0 | 2.0 | 50 | 25 |"
