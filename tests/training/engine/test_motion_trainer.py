"""Training by trajectories, from perception outputs that are computed by hand."""

import copy
from dataclasses import replace

import pytest
import torch

from training.engine.motion_trainer import (
    MOTION_PARTS,
    BallPerceptionOutputs,
    MotionTraining,
    train_motion,
    trajectory_loss,
)
from training.networks.any_ball import AnyBallNet

STEPS = 12
"""Frames of the truth, the seen ones among them."""


@pytest.fixture
def network() -> AnyBallNet:
    torch.manual_seed(4)
    return AnyBallNet()


def outputs(windows: int, balls: int, *, known: bool = True) -> BallPerceptionOutputs:
    """Balls that roll evenly over level ground, each as far from the others as the frame allows."""
    generator = torch.Generator().manual_seed(windows)
    start = torch.rand(windows, balls, 1, 2, generator=generator) - 0.5
    start = start + torch.arange(balls)[:, None, None] * 0.4 - 0.3
    velocity = 0.04 * (torch.rand(windows, balls, 1, 2, generator=generator) - 0.5)
    flat = start + torch.arange(STEPS)[:, None] * velocity
    radius = 0.1
    centres = torch.cat([flat, torch.full_like(flat[..., :1], radius)], dim=-1)
    if not known:
        centres[:, :, 4:] = torch.nan
    return BallPerceptionOutputs(
        places=flat[:, :, :4],
        radii=torch.full((windows, balls), radius),
        visible=torch.full((windows, balls, 4), 9.0),
        log_sigmas=torch.full((windows, balls, 2), -5.0),
        features=torch.zeros(windows, balls, 128),
        ground=torch.zeros(windows, 3, 32, 32),
        scene=torch.zeros(windows, 2),
        spacing=torch.ones(windows),
        centres=centres,
        spins=torch.full((windows, balls, STEPS - 3, 3), torch.nan),
    )


def test_the_loss_falls_and_the_perception_stays(network):
    before = copy.deepcopy(network.state_dict())
    training = MotionTraining(60, batch_size=16, horizon=8, state_rate=3e-3, motion_rate=3e-4)
    losses = list(train_motion(network, {1: outputs(40, 1), 2: outputs(24, 2)}, training))
    fixed = trajectory_loss(network, outputs(32, 2), 8, training.halving).item()
    network.load_state_dict(before)
    untrained = trajectory_loss(network, outputs(32, 2), 8, training.halving).item()
    assert len(losses) == 60
    assert fixed < 0.5 * untrained


def test_only_the_states_and_the_motion_change(network):
    before = copy.deepcopy(network.state_dict())
    training = MotionTraining(3, batch_size=8, horizon=6)
    list(train_motion(network, {1: outputs(16, 1)}, training))
    changed = {
        name for name, value in network.state_dict().items() if not torch.equal(value, before[name])
    }
    assert changed
    assert all(name.startswith(MOTION_PARTS) for name in changed)


def test_what_is_not_known_costs_nothing(network):
    known = outputs(4, 2, known=False)
    first = trajectory_loss(network, known, 2, 10.0)
    later = trajectory_loss(network, known, 8, 10.0)
    assert torch.isfinite(later)
    later.backward()
    # Of the steps after t = 0, no loss depends on the motion.
    gradients = [p.grad for p in network.rolling.parameters() if p.grad is not None]
    assert all(gradient.abs().max() == 0 for gradient in gradients)
    assert first > 0


def test_a_training_is_reproducible(network):
    training = replace(MotionTraining(4, batch_size=8, horizon=6), seed=3)
    other = copy.deepcopy(network)
    one = list(train_motion(network, {1: outputs(16, 1)}, training))
    assert one == list(train_motion(other, {1: outputs(16, 1)}, training))
