"""The table of a set-up, on clips whose figures are known beforehand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rollcast.footage import SquareCrop
from training.common.run_folder import BEST
from training.data.clip_dataset import Clip, Clips
from training.recipes import RECIPES
from training.reporting.footage_report import (
    T_GEN,
    T_TRAIN,
    Measured,
    SetupClips,
    markdown,
    measure,
)

SPEED_PX = (0.5, 1.0)
FRAMES = 60


def straight(seed: int) -> Clip:
    """Two balls that roll straight on, each at its own speed."""
    generator = np.random.default_rng(seed)
    ways = [
        start + speed * np.outer(np.arange(FRAMES), (np.cos(angle), np.sin(angle)))
        for speed, start, angle in zip(
            SPEED_PX, generator.uniform(50, 70, (2, 2)), generator.uniform(0, 6, 2), strict=True
        )
    ]
    frames = generator.integers(0, 256, (FRAMES, 128, 128, 3), dtype=np.uint8)
    return Clip(
        f"clip{seed}",
        frames,
        np.stack(ways),
        np.zeros(FRAMES, bool),
        30.0,
        SquareCrop(0, 0, 128),
        ("#ff0000", "#0000ff"),
    )


@pytest.fixture
def setup() -> SetupClips:
    return SetupClips(
        {split: Clips([straight(k)]) for k, split in enumerate(("training", "validation", "test"))}
    )


def by_balls(rows: list[Measured]) -> dict[str, dict[int, float]]:
    return {row.balls: {t: error for t, (error, _) in row.errors.items()} for row in rows}


def test_constant_position_errs_by_the_displacement_of_the_balls(setup):
    errors = by_balls(list(measure(setup, ["constant position"], [])))
    for t in (T_TRAIN, T_GEN):
        assert errors["all"][t] == pytest.approx(np.mean(SPEED_PX) * (t - 1), abs=1e-3)
        assert errors["first"][t] == pytest.approx(SPEED_PX[0] * (t - 1), abs=1e-3)


@pytest.mark.parametrize("method", ["linear", "quadratic"])
def test_polynomials_err_by_nothing_on_a_straight_way(setup, method):
    errors = by_balls(list(measure(setup, [method], [])))
    assert max(errors["all"].values()) < 1e-3


def test_states_are_places_and_displacements(setup):
    states = setup.states("test")
    clip = setup.clips["test"].clips[0]
    first = setup.places["test"][1].start
    places = 64 + 64 * states.positions[1].numpy()
    np.testing.assert_allclose(places[:, 0], clip.positions[:, first], atol=1e-4)
    speeds = 64 * states.velocities.norm(dim=-1)
    np.testing.assert_allclose(speeds[:, 0], SPEED_PX[0], atol=1e-4)
    np.testing.assert_allclose(speeds[:, 1], SPEED_PX[1], atol=1e-4)


def test_a_run_is_measured_with_the_ellipses_of_its_validation_clips(setup, tmp_path, monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path))
    recipe = replace(RECIPES["setup-2-balls"](), name="untrained")
    torch.manual_seed(0)
    (name, network), *_ = recipe.build().networks().items()
    (tmp_path / "untrained").mkdir()
    torch.save({"weights": {name: network.state_dict()}}, tmp_path / "untrained" / BEST)
    every, first = measure(setup, [], [recipe])
    assert (every.balls, first.balls) == ("all", "first")
    assert every.inside is not None
    for half, most in every.inside.values():
        assert 0 <= half <= most <= 1
    assert f"| untrained | first | {first.errors[T_TRAIN][0]:.1f} ±" in markdown(
        [every, first], setup
    )
