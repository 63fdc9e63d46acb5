"""The network for any number of balls: what holds whatever it has learned."""

from pathlib import Path

import numpy as np
import pytest
import torch

from rollcast.patches import cut_patches as cut_in_numpy
from training.export.load import any_ball_from, load_exported
from training.networks.any_ball import AnyBallNet, SizedPairInteraction, seen_balls
from training.networks.ball_detector import BallMaps, peaks, voted
from training.networks.fieldnet import Ball
from training.networks.patch_refiner import Outline, PatchRefiner, Registration
from training.networks.patches import cut_patches, half_widths
from training.networks.perception import FEATURES
from training.networks.recurrent import State

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture(scope="module")
def network() -> AnyBallNet:
    return any_ball_from(MODELS).eval()


def state_of(centres: torch.Tensor, velocities: torch.Tensor, radius: float = 0.15) -> State:
    """A state [1, N] of balls that stand on level ground."""
    count = len(centres)
    centres = torch.cat([centres, torch.full((count, 1), radius)], dim=1)
    velocities = torch.cat([velocities, torch.zeros(count, 1)], dim=1)
    constants = torch.tensor([0.0, 5 * radius * 1.05]).expand(count, 2)
    ball = Ball(centres, velocities, torch.zeros(count, 3), torch.zeros(count, 3), constants)
    return State(torch.zeros(1, 3, 32, 32), ball.packed()[None])


def test_patches_are_the_same_in_torch_and_in_numpy():
    generator = np.random.default_rng(0)
    frames = generator.integers(0, 256, (4, 128, 128, 3), dtype=np.uint8)
    places = generator.uniform(-1.05, 1.05, (3, 4, 2))
    widths = half_widths(torch.tensor([0.02, 0.2, 0.5]))
    tensors = torch.from_numpy(frames)[None], torch.from_numpy(places).float()[None]
    patches = cut_patches(*tensors, widths[None])[0].numpy()
    assert np.allclose(patches, cut_in_numpy(frames, places, widths.numpy()), atol=1e-4)


@pytest.mark.parametrize("shift", [(0.8, -0.5), (-0.3, 0.2), (0.0, 0.0)])
def test_registration_finds_how_far_a_texture_has_gone(shift):
    torch.manual_seed(1)
    y, x = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    frames = []
    for frame in range(4):
        u, v = x - frame * shift[0], y - frame * shift[1]
        layers = [
            torch.sin(0.45 * u + 0.2 * v),
            torch.cos(0.4 * v - 0.1 * u),
            torch.sin(0.3 * (u + v)),
        ]
        frames.append(torch.stack(layers))
    with torch.inference_mode():
        displacements, _ = Registration()(torch.stack(frames)[None])
    samples = displacements[0, 0] * 16
    assert torch.allclose(samples, torch.tensor(shift).expand(3, 2), atol=0.12)


def test_the_outline_is_the_circle_through_the_edge():
    generator = torch.Generator().manual_seed(2)
    angles = torch.arange(24) * (2 * torch.pi / 24)
    centre, radius = torch.tensor([[0.05, -0.03]] * 4), 0.08
    # Distance of a circle from a point near its centre, to first order.
    edge = centre[:, :1] * angles.cos() + centre[:, 1:] * angles.sin() + radius
    weight = torch.rand(1, 4, 24, generator=generator)
    weight[:, :, :8] = 0  # a third of the edge is hidden
    found, _ = Outline().fitted(edge[None], 50 * weight)
    assert torch.allclose(found[0], centre, atol=0.006)  # a ridge of 1 in 50


def test_without_an_edge_the_outline_stays_at_the_rough_centre():
    found, said = Outline().fitted(torch.rand(1, 4, 24), torch.zeros(1, 4, 24))
    assert found.abs().max() == 0
    assert torch.isfinite(said).all()


def test_an_untaught_refiner_stays_where_the_patch_is():
    with torch.inference_mode():
        said = PatchRefiner()(torch.full((2, 4, 3, 32, 32), 0.3))
    assert said.offsets.abs().max() < 1e-6
    assert torch.allclose(said.log_radius.exp(), torch.tensor(1 / 1.6))


def test_peaks_are_the_hottest_cells_among_their_neighbours():
    heat = torch.full((1, 32, 32), -5.0)
    heat[0, 4, 7], heat[0, 4, 8], heat[0, 20, 30] = 2.0, 1.0, 3.0
    places = torch.zeros(1, 4, 2, 32, 32)
    places[0, :, 0, 20, 30], places[0, :, 0, 4, 7] = 0.5, 0.25
    maps = BallMaps(heat, heat, places, heat * 0 - 2, torch.zeros(1, 3, 32, 32), torch.zeros(1, 2))
    found = peaks(maps)
    assert found.places[0, :2, 0, 0].tolist() == [0.5, 0.25]
    assert (found.scores[0, :3] > 0.5).tolist() == [True, True, False]


def test_a_vote_is_read_between_the_cells():
    along = (torch.arange(32) + 0.5) / 16 - 1
    places = along.expand(32, 32).expand(1, 4, 2, 32, 32)
    flat = torch.zeros(1, 32, 32)
    maps = BallMaps(flat, flat, places, flat - 2, torch.zeros(1, 3, 32, 32), torch.zeros(1, 2))
    said = voted(maps, torch.tensor([[[0.31, 0.7]]]))
    assert torch.allclose(said.places, torch.tensor(0.31), atol=1e-5)
    assert torch.allclose(said.radii, torch.tensor(-2.0).exp())


def test_a_ball_alone_moves_as_in_the_network_of_one_ball(network):
    _, one = load_exported(MODELS / "fieldnet" / "1")
    state = state_of(torch.tensor([[0.2, -0.3]]), torch.tensor([[0.05, 0.02]]), radius=0.2)
    with torch.inference_mode():
        mine, theirs = state, state
        for _ in range(5):
            mine, theirs = network.advance(mine), one.advance(theirs)
    assert torch.allclose(mine.p, theirs.p, atol=1e-5)


def test_balls_out_of_reach_do_not_matter_and_their_order_is_free(network):
    centres = torch.tensor([[-0.6, -0.5], [0.1, 0.1], [0.62, 0.55]])
    velocities = torch.tensor([[0.02, 0.0], [0.0, 0.03], [-0.01, 0.01]])
    order = torch.tensor([2, 0, 1])
    with torch.inference_mode():
        together = network.roll_out(state_of(centres, velocities), 4).positions
        turned = network.roll_out(state_of(centres[order], velocities[order]), 4).positions
        alone = network.roll_out(state_of(centres[:1], velocities[:1]), 4).positions
    assert torch.allclose(turned[0], together[0][order], atol=1e-3)
    assert torch.allclose(alone[0, 0], together[0, 0], atol=1e-3)


def test_balls_in_reach_do_matter(network):
    apart = torch.tensor([[-0.17, 0.0], [0.17, 0.0]])
    towards = torch.tensor([[0.06, 0.0], [-0.06, 0.0]])
    with torch.inference_mode():
        both = network.roll_out(state_of(apart, towards), 4).positions
        alone = network.roll_out(state_of(apart[:1], towards[:1]), 4).positions
    assert (both[0, 0, -1] - alone[0, 0, -1]).norm() > 1


@pytest.mark.parametrize("spacing", [0.32, 2.5])
def test_velocities_are_of_a_step_whatever_the_spacing_of_the_frames(spacing):
    torch.manual_seed(3)
    network = AnyBallNet()
    torch.nn.init.normal_(network.covariance_from_sigmas.weight)
    with torch.no_grad():
        network.perception.state[0].weight[:, -1] = 0  # what is learned of the spacing itself
    back = torch.arange(-3.0, 1)[:, None] * torch.tensor([0.05, 0.02])
    features, scene = torch.randn(1, 1, FEATURES), torch.zeros(1, 2)
    log_sigmas = torch.tensor([[[-5.0, -4.0]]])

    def begun(spacing: float, blur: float) -> State:
        places = (torch.tensor([0.1, -0.2]) + spacing * back)[None, None]
        sigmas = log_sigmas + torch.tensor([0.0, blur])
        seen = seen_balls(places, torch.tensor([[0.1]]), places[..., 0], sigmas, features)
        ground = 0.1 * torch.ones(1, 3, 32, 32)
        return network.begin(seen, ground, scene, torch.tensor([spacing]))[0]

    # A displacement that is known as well, relative to the time that it took.
    usual, other = begun(1.0, 0.0), begun(spacing, float(np.log(spacing)))
    assert torch.allclose(usual.p, other.p, atol=1e-4)


def test_balls_of_other_sizes_touch_at_the_sum_of_their_radii():
    constants = torch.tensor([[[0.0, 5 * 0.1 * 1.05], [0.0, 5 * 0.3 * 1.05]]])
    zeros = torch.zeros(1, 2, 3)
    reach = SizedPairInteraction().reach(Ball(zeros, zeros, zeros, zeros, constants))
    assert torch.allclose(reach[0, 0, 1], torch.tensor(0.4), atol=1e-6)
    assert torch.allclose(reach, reach.transpose(1, 2))
