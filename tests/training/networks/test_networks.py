import copy

import pytest
import torch

from training.networks.blocks import normalised_frames
from training.networks.compact import HEADS, compact_family
from training.networks.recurrent import (
    LARGEST_VARIANCE_PX2,
    SMALLEST_VARIANCE_PX2,
    GaussianOutput,
    RecurrentNetwork,
    SharedStateFamily,
    logit_of_variance,
)
from training.networks.task import Task


def compact(variant: str, objects: int = 1, *, angular_velocity: bool = True) -> RecurrentNetwork:
    task = Task(objects, final_step_of(variant), angular_velocity=angular_velocity)
    return compact_family({"it": variant}, task).networks()["it"]


def final_step_of(variant: str) -> int | None:
    return 39 if variant == "interpnet" else None


def images(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.randint(0, 256, (2, count, 128, 128, 3), dtype=torch.uint8, generator=generator)


@pytest.fixture(params=HEADS)
def variant(request) -> str:
    return request.param


@pytest.fixture
def frames(variant):
    return images(5 if variant == "interpnet" else 4)


@pytest.mark.parametrize("objects", [1, 3])
def test_shapes_of_a_rollout(variant, objects, frames):
    predictor = compact(variant, objects)
    forecast = predictor(frames, 5)
    assert forecast.positions.shape == (2, objects, 5, 2)
    assert forecast.angular_velocities.shape == (2, objects, 5, 3)
    if variant == "probnet":
        assert forecast.covariances.shape == (2, objects, 5, 2, 2)
    else:
        assert forecast.covariances is None
    if variant == "interpnet":
        assert forecast.final_positions.shape == (2, objects, 2)
    else:
        assert forecast.final_positions is None


def test_a_longer_rollout_begins_like_a_shorter_one(variant, frames):
    predictor = compact(variant).eval()
    with torch.inference_mode():
        torch.testing.assert_close(
            predictor(frames, 6).positions[:, :, :3], predictor(frames, 3).positions
        )


def shake(network: torch.nn.Module) -> None:
    """Blocks begin as the identity: their inner layers matter once the outer ones have moved."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.01 * torch.randn_like(parameter))


@pytest.mark.parametrize(
    ("names", "final_step"), [(("posnet", "dispnet", "probnet"), None), (("interpnet",), 39)]
)
def test_a_family_forecasts_what_its_members_forecast_alone(names, final_step):
    torch.manual_seed(2)
    task = Task(2, final_step)
    family = compact_family({name: name for name in names}, task).eval()
    with torch.inference_mode():
        together = family(images(task.frames), 4)
        for name, member in family.networks().items():
            for one, other in zip(together[name], member(images(task.frames), 4), strict=True):
                torch.testing.assert_close(one, other)


def encoder_of_swapped(encoder: torch.nn.Module) -> torch.nn.Module:
    """Encoder that gives the first ball's state to the second and the other way round."""
    swapped = copy.deepcopy(encoder)
    swapped.register_forward_hook(lambda _module, _inputs, s: s.flip(1))
    return swapped


@pytest.mark.parametrize("interaction", [True, False])
@pytest.mark.parametrize("name", ["posnet", "dispnet", "probnet", "interpnet"])
def test_swapped_balls_take_swapped_courses(name, interaction):
    task = Task(2, final_step_of(name), interaction=interaction)
    family = compact_family({"it": name}, task)
    member = family.networks()["it"].eval()
    shake(member)
    swapped = copy.deepcopy(member)
    swapped.encoder = encoder_of_swapped(member.encoder)
    with torch.inference_mode():
        pairs = zip(member(images(task.frames), 5), swapped(images(task.frames), 5), strict=True)
        for one, other in pairs:
            if one is not None:
                assert not torch.allclose(one[:, 0], one[:, 1])
                torch.testing.assert_close(other, one.flip(1))


def test_balls_know_of_each_other_by_their_interaction_alone():
    torch.manual_seed(0)
    for interaction in (True, False):
        family = compact_family({"it": "posnet"}, Task(3, interaction=interaction))
        shake(family)
        transition = family.networks()["it"].transition
        s = torch.randn(1, 3, 128, 8, 8)
        moved = s.clone()
        moved[:, 1] += 1
        unchanged = torch.equal(transition(s)[:, 0], transition(moved)[:, 0])
        assert unchanged != interaction


def test_predictors_that_share_nothing_are_no_family():
    with pytest.raises(ValueError, match="share"):
        SharedStateFamily({"one": compact("posnet"), "other": compact("dispnet")})


def test_every_parameter_gets_a_gradient(variant, frames):
    torch.manual_seed(0)
    predictor = compact(variant)
    shake(predictor)
    forecast = predictor(frames, 3)
    sum(part.square().sum() for part in forecast if part is not None).backward()
    untouched = [
        name for name, p in predictor.named_parameters() if p.grad is None or not p.grad.any()
    ]
    # The bias of the softmax's logits moves all cells alike and so moves nothing.
    assert untouched == []


def test_angular_velocity_can_be_left_out(variant, frames):
    assert compact(variant, angular_velocity=False)(frames, 2).angular_velocities is None


@pytest.mark.parametrize("largest", [LARGEST_VARIANCE_PX2, 2500.0])
def test_covariances_keep_their_eigenvalues_within_the_bounds(largest):
    p = 50 * torch.randn(200, 1, 5, generator=torch.Generator().manual_seed(1), dtype=torch.double)
    eigenvalues = torch.linalg.eigvalsh(GaussianOutput(largest)(p)[1])
    assert eigenvalues.min() >= SMALLEST_VARIANCE_PX2 - 1e-9
    assert eigenvalues.max() <= largest + SMALLEST_VARIANCE_PX2 + 1e-9


def test_covariance_is_the_papers_rotation_of_a_diagonal():
    theta = 0.4
    p = torch.tensor([[0.0, 0.0, logit_of_variance(9.0), logit_of_variance(2.0), theta]])
    cos, sin = torch.cos(torch.tensor(theta)), torch.sin(torch.tensor(theta))
    rotation = torch.stack([torch.stack([cos, -sin]), torch.stack([sin, cos])])
    expected = rotation.T @ torch.diag(torch.tensor([9.0, 2.0])) @ rotation
    torch.testing.assert_close(GaussianOutput()(p)[1][0], expected)


def test_still_frames_have_empty_change_channels():
    still = images(1).expand(-1, 4, -1, -1, -1)
    assert not normalised_frames(still)[:, 3:12].any()
