"""Export of a network for footage, and the real service on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rollcast.client import Client
from rollcast.footage import SquareCrop
from rollcast.manifest import MANIFEST_FILE, Manifest
from tests.e2e.conftest import start_service, stop_service, wait_until_ready
from training.common.run_folder import BEST
from training.data.clip_dataset import Clip, Clips
from training.export.footage import export_setup
from training.export.load import load_exported
from training.recipes import RECIPES

FRAMES = 60
COLORS = ("#ff0000", "#00ff00", "#0000ff", "#ffff00")
RATE_HZ = 29.97


def clip(name: str, seed: int) -> Clip:
    """Four balls that roll straight on, in noise: frames that nobody learns from."""
    generator = np.random.default_rng(seed)
    steps = generator.uniform(-0.4, 0.4, (4, 1, 2)) * np.arange(FRAMES)[:, None]
    return Clip(
        name,
        generator.integers(0, 256, (FRAMES, 128, 128, 3), dtype=np.uint8),
        generator.uniform(50, 70, (4, 1, 2)) + steps,
        np.zeros(FRAMES, bool),
        RATE_HZ,
        SquareCrop(125, 0, 478),
        COLORS,
    )


@pytest.fixture(scope="module")
def clips() -> dict[str, Clips]:
    names = ("training", "validation", "test")
    return {split: Clips([clip(split[:4], seed)]) for seed, split in enumerate(names)}


@pytest.fixture(scope="module")
def models(clips, tmp_path_factory) -> Path:
    top = tmp_path_factory.mktemp("setup")
    recipe = RECIPES["setup-4-balls"]()
    torch.manual_seed(0)
    ((name, network),) = recipe.build().networks().items()
    with torch.no_grad():
        # The exporter folds parameters away that are still zero.
        for parameter in network.parameters():
            parameter.add_(0.003 * torch.randn(parameter.shape))
    best = {"weights": {name: network.state_dict()}, "sequences": 640, "horizon": 15}
    torch.save(best, top / BEST)
    export_setup(recipe, top, clips, top / "models", "arena", 3)
    return top / "models"


def test_the_manifest_tells_of_the_set_up(models):
    manifest = Manifest.read(models / "arena" / "3" / MANIFEST_FILE)
    assert (manifest.label, manifest.scenarios) == ("arena@3", ("footage",))
    assert (manifest.objects, manifest.angular_velocity) == (4, False)
    assert manifest.frame_rate_hz == RATE_HZ
    assert manifest.colors == COLORS
    assert manifest.setup is not None
    assert manifest.setup.crop == (125, 0, 478)
    assert manifest.training["clips"] == {"trai": FRAMES - 3 - 30 + 1}
    assert {row.scenario for row in manifest.metrics} == {"footage"}
    assert {row.horizon for row in manifest.metrics} == {1, 7, 15, 30}
    assert manifest.ood is not None
    assert manifest.validation_error_px > 0
    with pytest.raises(ValueError, match="knows footage"):
        _ = manifest.simulated


def test_a_line_errs_by_nothing_on_a_straight_way(models):
    manifest = Manifest.read(models / "arena" / "3" / MANIFEST_FILE)
    assert all(
        row.linear_extrapolation_px is not None and row.linear_extrapolation_px < 1e-3
        for row in manifest.metrics
    )


def test_training_goes_on_from_the_export(models):
    manifest, network = load_exported(models / "arena" / "3")
    other = replace(RECIPES["setup-4-balls"]()).build().networks()["setup-4"]
    assert network.state_dict().keys() == other.state_dict().keys()
    assert manifest.training["sequences"] == 640


def test_the_service_forecasts_with_it(models, clips):
    process, address = start_service(ROLLCAST_MODELS_DIR=str(models))
    try:
        with Client(address) as client:
            wait_until_ready(client)
            frames = clips["test"].clips[0].frames[:4]
            forecast = client.predict(list(frames), model="arena", horizon=20)
    finally:
        stop_service(process)
    _, network = load_exported(models / "arena" / "3")
    with torch.inference_mode():
        expected = network(torch.from_numpy(frames)[None], 20).positions[0]
    assert forecast.colors == COLORS
    assert forecast.frame_rate == RATE_HZ
    assert forecast.angular_velocities is None
    np.testing.assert_allclose(forecast.positions, expected.numpy(), atol=1e-2)
