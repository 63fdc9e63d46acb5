"""The zoomed pass, and point prompts."""

import numpy as np
import pytest
import torch

from training.engine.warm_start import load_fitting
from training.networks.fieldnet import FieldNet
from training.networks.perception import (
    LARGEST_SEEN,
    SMALLEST_SEEN,
    USUAL_RADIUS,
    Perception,
    ZoomedRefiner,
)
from training.networks.presets import PRESETS
from training.networks.task import Task

FRAMES = torch.from_numpy(
    np.random.default_rng(0).integers(0, 256, (2, 4, 128, 128, 3), dtype=np.uint8)
)
NOWHERE = torch.full((2, 1, 2), torch.nan)


@pytest.fixture(scope="module")
def perception() -> Perception:
    torch.manual_seed(0)
    return Perception(1, ZoomedRefiner()).eval()


def test_a_prompt_is_where_the_closer_look_begins(perception):
    prompts = torch.tensor([[[0.3, -0.2]], [[torch.nan, torch.nan]]])
    with torch.inference_mode():
        prompted, alone = perception(FRAMES, prompts), perception(FRAMES)
    first = prompted.seen_positions[0]
    torch.testing.assert_close(first[0], prompts[:1].expand(1, 4, 2))
    for one, other in zip(prompted.seen_positions, alone.seen_positions, strict=True):
        torch.testing.assert_close(one[1], other[1])


def test_without_a_place_a_prompt_changes_nothing(perception):
    with torch.inference_mode():
        prompted, alone = perception(FRAMES, NOWHERE), perception(FRAMES)
    torch.testing.assert_close(prompted.centres, alone.centres)


def test_radii_stay_within_what_can_be_seen(perception):
    with torch.inference_mode():
        torch.testing.assert_close(perception(FRAMES).radii, torch.full((2, 1), USUAL_RADIUS))
        perception.zoomed.size.bias.fill_(9)
        torch.testing.assert_close(perception(FRAMES).radii, torch.full((2, 1), LARGEST_SEEN))
        perception.zoomed.size.bias.fill_(-9)
        torch.testing.assert_close(perception(FRAMES).radii, torch.full((2, 1), SMALLEST_SEEN))
        perception.zoomed.size.bias.zero_()


def test_corrections_scale_with_the_patch():
    torch.manual_seed(1)
    refiner = ZoomedRefiner().refiner.eval()
    torch.nn.init.normal_(refiner.correction.bias)
    torch.nn.init.zeros_(refiner.correction.weight)
    images, around = torch.rand(1, 4, 3, 128, 128), torch.zeros(1, 1, 4, 2)
    with torch.inference_mode():
        usual, _ = refiner(images, around, torch.ones(1, 1))
        near, _ = refiner(images, around, torch.full((1, 1), 0.25))
    torch.testing.assert_close(near, 0.25 * usual)


def test_it_begins_as_a_network_without_it():
    torch.manual_seed(2)
    plain, zoomed = FieldNet(Task()).eval(), FieldNet(Task(), ZoomedRefiner()).eval()
    with torch.no_grad():
        plain.perception.closer.correction.weight.normal_(std=0.01)
    taken = load_fitting(zoomed, plain.state_dict())
    assert any(name.startswith("perception.zoomed.refiner.") for name in taken)
    with torch.inference_mode():
        one, other = plain(FRAMES, 3), zoomed(FRAMES, 3)
    torch.testing.assert_close(one.positions, other.positions)
    with torch.no_grad():
        zoomed.perception.zoomed.refiner.correction.bias.fill_(0.1)
    again = FieldNet(Task(), ZoomedRefiner())
    load_fitting(again, zoomed.state_dict())
    assert float(again.perception.zoomed.refiner.correction.bias.detach()[0]) == pytest.approx(0.1)


def test_it_is_a_preset_of_its_own():
    (network,) = PRESETS["zoomed"]({"fieldnet": "fieldnet"}, Task()).networks().values()
    assert isinstance(network, FieldNet)
    assert network.perception.zoomed is not None
    with pytest.raises(ValueError, match="only have the variant fieldnet"):
        PRESETS["zoomed"]({"posnet": "posnet"}, Task())


def test_every_parameter_of_it_is_used():
    """An unused one would be missing in an exported graph."""
    torch.manual_seed(3)
    perception = Perception(1, ZoomedRefiner())
    passes, *read = perception(FRAMES)
    sum(part.square().sum() for part in (*passes, *read)).backward()
    assert all(parameter.grad is not None for parameter in perception.parameters())
