import pytest
import torch

from training.models.blocks import normalised_frames
from training.models.compact import HEADS, compact_family
from training.models.predictor import (
    LARGEST_VARIANCE_PX2,
    SMALLEST_VARIANCE_PX2,
    Family,
    GaussianOutput,
    Predictor,
    logit_of_variance,
)


def compact(variant: str, objects: int = 1, *, angular_velocity: bool = True) -> Predictor:
    family = compact_family({"it": variant}, 4, objects, angular_velocity=angular_velocity)
    return family.predictors()["it"]


@pytest.fixture
def frames():
    generator = torch.Generator().manual_seed(3)
    return torch.randint(0, 256, (2, 4, 128, 128, 3), dtype=torch.uint8, generator=generator)


@pytest.mark.parametrize("variant", HEADS)
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


@pytest.mark.parametrize("variant", HEADS)
def test_a_longer_rollout_begins_like_a_shorter_one(variant, frames):
    predictor = compact(variant).eval()
    with torch.inference_mode():
        torch.testing.assert_close(
            predictor(frames, 6).positions[:, :, :3], predictor(frames, 3).positions
        )


def test_a_family_forecasts_what_its_members_forecast_alone(frames):
    torch.manual_seed(2)
    variants = {name: name for name in HEADS}
    family = compact_family(variants, 4, 1, angular_velocity=True).eval()
    with torch.inference_mode():
        together = family(frames, 4)
        for name, member in family.predictors().items():
            torch.testing.assert_close(tuple(together[name]), tuple(member(frames, 4)))


def test_predictors_that_share_nothing_are_no_family():
    with pytest.raises(ValueError, match="share"):
        Family({"one": compact("posnet"), "other": compact("dispnet")})


@pytest.mark.parametrize("variant", HEADS)
def test_every_parameter_gets_a_gradient(variant, frames):
    torch.manual_seed(0)
    predictor = compact(variant)
    # Blocks begin as the identity: their inner layers learn once the outer ones have moved.
    with torch.no_grad():
        for parameter in predictor.parameters():
            parameter.add_(0.01 * torch.randn_like(parameter))
    forecast = predictor(frames, 3)
    sum(part.square().sum() for part in forecast if part is not None).backward()
    untouched = [
        name for name, p in predictor.named_parameters() if p.grad is None or not p.grad.any()
    ]
    # The bias of the softmax's logits moves all cells alike and so moves nothing.
    assert untouched == []


def test_angular_velocity_can_be_left_out(frames):
    assert compact("posnet", angular_velocity=False)(frames, 2).angular_velocities is None


def test_covariances_keep_their_eigenvalues_within_the_bounds():
    p = 50 * torch.randn(200, 1, 5, generator=torch.Generator().manual_seed(1), dtype=torch.double)
    eigenvalues = torch.linalg.eigvalsh(GaussianOutput()(p)[1])
    assert eigenvalues.min() >= SMALLEST_VARIANCE_PX2 - 1e-9
    assert eigenvalues.max() <= LARGEST_VARIANCE_PX2 + SMALLEST_VARIANCE_PX2 + 1e-9


def test_covariance_is_the_papers_rotation_of_a_diagonal():
    theta = 0.4
    p = torch.tensor([[0.0, 0.0, logit_of_variance(9.0), logit_of_variance(2.0), theta]])
    cos, sin = torch.cos(torch.tensor(theta)), torch.sin(torch.tensor(theta))
    rotation = torch.stack([torch.stack([cos, -sin]), torch.stack([sin, cos])])
    expected = rotation.T @ torch.diag(torch.tensor([9.0, 2.0])) @ rotation
    torch.testing.assert_close(GaussianOutput()(p)[1][0], expected)


def test_still_frames_have_empty_change_channels(frames):
    still = frames[:, :1].expand(-1, 4, -1, -1, -1)
    assert not normalised_frames(still)[:, 3:12].any()
