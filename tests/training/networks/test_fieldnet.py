"""The network with an explicit state against known truths: motion, perception and losses."""

import pytest
import torch

from training.engine.warm_start import load_fitting
from training.networks.fieldnet import AHEAD, Ball, FieldNet, PairInteraction, field_family
from training.networks.perception import (
    PATCH_HALF_WIDTH,
    Perception,
    PositionRefiner,
    radius_of,
    rise_along,
    rolling_spin,
    sampled,
)
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Observation, PerceptionOutput, State
from training.networks.task import Task
from training.objectives.losses import (
    DetachedNllLoss,
    DistanceLoss,
    LikelihoodLoss,
    MotionLoss,
    PerceptionLoss,
)
from training.recipes.field import field_one_ball, field_several_balls
from training.recipes.recipe import continued, horizon_at

FRAMES = torch.randint(
    0, 256, (2, 4, 128, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(3)
)


def balls(centres: torch.Tensor, velocities: torch.Tensor) -> Ball:
    """Balls of radius 0.225 m in a bowl's frame that do not turn."""
    constants = torch.tensor([0.0, 5 * 0.225]).expand(*centres.shape[:2], 2)
    none = torch.zeros_like(centres)
    return Ball(centres, velocities, none, none, constants)


def field_net(objects: int = 1, *, interaction: bool = True) -> FieldNet:
    torch.manual_seed(11)
    return FieldNet(Task(objects, interaction=interaction)).eval()


def unsettled(network: FieldNet) -> FieldNet:
    """Give weights that begin at zero some of any size."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.03 * torch.randn(parameter.shape))
    return network


def test_untaught_balls_move_uniformly():
    """Without any change learned, p_t = p_0 + t v, whatever the ground."""
    start = balls(torch.tensor([[[0.1, -0.2, 0.3]]]), torch.tensor([[[0.02, 0.01, -0.005]]]))
    ground = torch.randn(1, 3, 32, 32)
    with torch.inference_mode():
        forecast = field_net().roll_out(State(ground, start.packed()), 12)
    steps = torch.arange(12.0)[:, None]
    expected = 64 + 64 * (start.centre[0, 0, :2] + steps * start.velocity[0, 0, :2])
    torch.testing.assert_close(forecast.positions[0, 0], expected)
    assert (forecast.angular_velocities == 0).all()


def test_a_rollout_stays_bounded():
    network = unsettled(field_net())
    with torch.inference_mode():
        forecast = network(FRAMES, 400)
    assert torch.isfinite(forecast.positions).all()
    assert torch.isfinite(forecast.covariances).all()


def test_the_state_is_packed_and_unpacked():
    p = torch.arange(14.0)
    ball = Ball.unpacked(p)
    assert torch.equal(ball.packed(), p)
    bowl = balls(torch.zeros(1, 1, 3), torch.zeros(1, 1, 3))
    assert float(bowl.radius) == pytest.approx(0.225 / 1.05)


def test_the_ground_is_felt_where_the_ball_is():
    ground = torch.zeros(1, 3, 32, 32)
    ground[0, 2, 8, 24] = 1.0
    x, y = (24.5 / 16 - 1), (8.5 / 16 - 1)
    felt = sampled(ground, torch.tensor([[[[x, y], [-x, y]]]]))
    assert felt.shape == (1, 1, 2, 3)
    torch.testing.assert_close(felt[0, 0, :, 2], torch.tensor([1.0, 0.0]))


def test_balls_swapped_before_are_balls_swapped_after():
    network = unsettled(field_net(2))
    pair = balls(
        torch.tensor([[[0.1, 0.0, 0.2], [0.4, 0.1, 0.2]]]),
        torch.tensor([[[0.05, 0.0, 0.0], [-0.02, 0.01, 0.0]]]),
    )
    ground = torch.randn(1, 3, 32, 32)
    with torch.inference_mode():
        one = network.rolling(pair, ground)
        other = network.rolling(Ball(*(part.flip(1) for part in pair)), ground)
    for part, swapped in zip(one, other, strict=True):
        torch.testing.assert_close(part, swapped.flip(1))


def test_only_balls_within_reach_tell_each_other_something():
    torch.manual_seed(2)
    interaction = PairInteraction()
    diameter = 2 * 0.225 / 1.05
    still = torch.zeros(1, 3, 3)
    apart = torch.tensor([[[0.0, 0.0, 0.0], [1.02 * diameter, 0.0, 0.0], [0.0, -0.9, 0.0]]])
    message = interaction(balls(apart, still))
    assert message[0, 0].abs().max() > 0
    torch.testing.assert_close(message[0, 2], torch.zeros_like(message[0, 2]))
    # One that will be there within the frame is heard in time.
    closing = still.clone()
    closing[0, 2, 1] = 0.9 - diameter
    assert interaction(balls(apart, closing))[0, 2].abs().max() > 0
    assert max(AHEAD) == 1


def test_without_interaction_balls_do_not_notice_each_other():
    network = unsettled(field_net(2, interaction=False))
    centres = torch.tensor([[[0.0, 0.0, 0.2], [0.3, 0.0, 0.2]]])
    still = torch.zeros_like(centres)
    ground = torch.randn(1, 3, 32, 32)
    with torch.inference_mode():
        near = network.rolling(balls(centres, still), ground)
        centres[0, 1, 0] = 0.9
        far = network.rolling(balls(centres, still), ground)
    torch.testing.assert_close(near.centre[:, 0], far.centre[:, 0])


@pytest.mark.parametrize("normal_xy", [(0.0, 0.0), (0.3, -0.2), (-0.6, 0.4)])
def test_a_ball_that_rolls_does_not_slip(normal_xy):
    """v = omega x r n: the touching point stands still; and v has no part along n."""
    normal_xy, flat = torch.tensor(normal_xy), torch.tensor([0.05, 0.03])
    velocity = torch.cat([flat, rise_along(normal_xy, flat)])
    normal = torch.cat([normal_xy, (1 - normal_xy.square().sum()).sqrt()[None]])
    assert float(velocity @ normal) == pytest.approx(0, abs=1e-7)
    radius = torch.tensor([0.2])
    to_world = torch.tensor([1.0, -1.0, 1.0])
    omega = rolling_spin(normal_xy, velocity, radius) * ANGULAR_VELOCITY_UNIT / 40
    carried = torch.linalg.cross(omega, radius * normal * to_world)
    torch.testing.assert_close(carried, velocity * to_world)
    assert float(omega @ (normal * to_world)) == pytest.approx(0, abs=1e-6)


def test_an_untaught_eye_takes_balls_to_be_rolling():
    torch.manual_seed(8)
    perception = Perception(1).eval()
    with torch.no_grad():
        for parameter in perception.state[-1].parameters():
            parameter.zero_()
        made = perception(FRAMES)
    exact = made.seen_positions[-1]
    torch.testing.assert_close(made.velocities[..., :2], exact[:, :, 3] - exact[:, :, 2])
    torch.testing.assert_close(made.centres[..., :2], exact[:, :, 3])
    normal_xy = sampled(made.ground, exact[:, :, 3:])[:, :, 0, :2]
    rolling = rolling_spin(normal_xy, made.velocities, radius_of(made.scene_constants[:, None]))
    torch.testing.assert_close(made.spins, rolling)


def test_a_closer_look_sees_its_own_patch_alone():
    torch.manual_seed(4)
    made = PositionRefiner(8).eval()
    with torch.no_grad():
        made.correction.weight.normal_()
    images = torch.rand(1, 4, 3, 128, 128)
    around = torch.tensor([[[[-0.5, -0.5]] * 4, [[0.5, 0.5]] * 4]])
    first, _ = made(images, around)
    changed = images.clone()
    changed[..., 64:, 64:] = 0
    second, _ = made(changed, around)
    assert PATCH_HALF_WIDTH < 0.5
    torch.testing.assert_close(first[:, 0], second[:, 0])
    assert (first[:, 1] - second[:, 1]).abs().max() > 1e-3
    alone, _ = made(images, around[:, 1:])
    torch.testing.assert_close(alone[:, 0], first[:, 1])


def test_a_perfect_reading_costs_nothing():
    torch.manual_seed(1)
    centres = torch.randn(3, 1, 9, 3)
    ground, constants = torch.randn(3, 3, 32, 32), torch.randn(3, 2)
    seen, now = centres[:, :, :4, :2], centres[:, :, 3]
    velocities = now - centres[:, :, 2]
    unused = torch.zeros(3, 1, 3)
    passes = (seen, seen, seen)
    perfect = PerceptionOutput(passes, ground, constants, now, velocities, unused, unused)
    unknown = ground.clone()
    unknown[:, :, :4] = torch.nan
    loss = PerceptionLoss()
    assert float(loss(perfect, (centres, unknown, constants))) == pytest.approx(0, abs=1e-5)
    for field in ("ground", "scene_constants", "centres", "velocities"):
        worse = perfect._replace(**{field: getattr(perfect, field) + 0.1})
        assert float(loss(worse, (centres, unknown, constants))) > 0.1


def test_the_ground_counts_most_where_the_balls_will_be():
    centres = torch.zeros(1, 1, 9, 3)
    centres[..., :2] = torch.linspace(-0.5, 0.5, 9)[:, None]
    ground = torch.zeros(1, 3, 32, 32)
    seen, now = centres[:, :, :4, :2], centres[:, :, 3]
    costs = []
    for row, column in ((16, 16), (2, 28)):
        read = ground.clone()
        read[0, 2, row - 1 : row + 1, column - 1 : column + 1] = 0.1
        velocities, unused = now - centres[:, :, 2], torch.zeros(1, 1, 3)
        passes, constants = (seen,) * 3, torch.zeros(1, 2)
        perceived = PerceptionOutput(passes, read, constants, now, velocities, unused, unused)
        costs.append(float(PerceptionLoss()(perceived, (centres, ground, torch.zeros(1, 2)))))
    assert costs[0] > 2 * costs[1] > 0


def test_perfect_motion_costs_nothing():
    truth = torch.randn(2, 1, 6, 3)
    loss = MotionLoss(halving=8)
    assert float(loss(truth, truth)) == 0
    # A constant shift of 0.1 half frames is 6.4 px, less the rounding, and no change of motion.
    shifted = truth + torch.tensor([0.1, 0, 0])
    assert float(loss(shifted, truth)) == pytest.approx(6.3, abs=0.01)


def test_the_covariance_leaves_the_positions_alone():
    """The gradient of the positions is that of their own loss."""
    truth = torch.zeros(1, 1, 5, 2)
    positions = torch.randn(1, 1, 5, 2, requires_grad=True)
    covariances = torch.eye(2).expand(1, 1, 5, 2, 2).clone().requires_grad_()
    distance = DistanceLoss(halving=8)
    forecast = Observation(positions, covariances, None)
    DetachedNllLoss(distance, LikelihoodLoss(halving=8), weight=0.5)(forecast, truth).backward()
    (expected,) = torch.autograd.grad(distance(forecast, truth), positions)
    torch.testing.assert_close(positions.grad, expected)
    assert covariances.grad is not None
    assert covariances.grad.abs().sum() > 0


def test_the_covariance_grows_without_moving_the_balls():
    """The likelihood trains the covariance alone, from perception to the last step."""
    network = field_net()
    forecast = network(FRAMES, 5)
    forecast.covariances.sum().backward()
    taught = {name for name, p in network.named_parameters() if p.grad is not None and p.grad.any()}
    assert taught
    assert all("covariance" in name for name in taught)


def test_several_balls_begin_as_one_ball_each():
    """Each is looked for as the single ball was, and nobody is heard before it is learned."""
    torch.manual_seed(9)
    one = unsettled(field_net())
    pair = field_net(2)
    load_fitting(pair, one.state_dict())
    with torch.inference_mode():
        alone, both = one.perception(FRAMES), pair.perception(FRAMES)
        for k in range(2):
            torch.testing.assert_close(both.seen_positions[0][:, k], alone.seen_positions[0][:, 0])
        start = balls(torch.tensor([[[0.1, 0.0, 0.2]]]), torch.tensor([[[0.05, 0.0, 0.0]]]))
        twice = Ball(*(part.repeat(1, 2, 1) for part in start))
        ground = torch.randn(1, 3, 32, 32)
        moved, moved_twice = one.rolling(start, ground), pair.rolling(twice, ground)
    for part, doubled in zip(moved, moved_twice, strict=True):
        torch.testing.assert_close(doubled, part.repeat(1, 2, 1))


def with_final_frame(step: int = 7) -> FieldNet:
    torch.manual_seed(11)
    return unsettled(FieldNet(Task(final_step=step)).eval())


def test_a_bent_way_begins_as_it_would_and_ends_at_the_final_place():
    one, two = unsettled(field_net()), with_final_frame()
    load_fitting(two, one.state_dict())
    frames = torch.cat([FRAMES, FRAMES[:, :1]], dim=1)
    with torch.inference_mode():
        bent, own = two(frames, 8), one(FRAMES, 8)
        at_rest = 64 + 64 * one.perception.at_rest(FRAMES[:, 0])
    torch.testing.assert_close(bent.final_positions, at_rest)
    torch.testing.assert_close(bent.positions[:, :, 0], own.positions[:, :, 0])
    torch.testing.assert_close(bent.positions[:, :, -1], at_rest, rtol=0, atol=1e-2)
    between = (bent.positions - own.positions)[:, :, 1:-1].norm(dim=-1)
    assert (between > 0.01).all()


def test_a_way_that_ends_well_is_left_alone():
    network = with_final_frame()
    start = balls(torch.tensor([[[0.1, -0.2, 0.3]]]), torch.tensor([[[0.02, 0.01, 0.0]]]))
    state = State(torch.randn(1, 3, 32, 32), start.packed())
    with torch.inference_mode():
        own, _ = network.forecast_from(state, 8)
        bent = network.roll_out(network.aimed(state, own[:, :, -1, :2]), 8)
    torch.testing.assert_close(bent.positions, 64 + 64 * own[..., :2])


def test_a_still_frame_is_four_of_balls_at_rest():
    network = unsettled(field_net())
    with torch.inference_mode():
        passes = network.perception(FRAMES[:, :1].expand(-1, 4, -1, -1, -1)).seen_positions
        at_rest = network.perception.at_rest(FRAMES[:, 0])
    torch.testing.assert_close(at_rest, passes[-1][:, :, -1])


def test_going_on_begins_with_perception_alone():
    recipe = continued(field_several_balls(2))
    assert horizon_at(recipe.curriculum, 0.5) == 1
    assert recipe.trained_horizon == field_several_balls(2).trained_horizon == 30
    assert continued(field_one_ball()).trained_horizon == 40


def test_what_the_preset_cannot_make_is_refused():
    with pytest.raises(ValueError, match="only have the variant fieldnet"):
        field_family({"one": "posnet"}, Task())


def test_without_angular_velocities_it_forecasts_the_same_places():
    telling, silent = field_net(1), field_family({"it": "fieldnet"}, Task(angular_velocity=False))
    network = silent.networks()["it"]
    network.load_state_dict(telling.state_dict())
    frames = torch.randint(0, 256, (1, 4, 128, 128, 3), dtype=torch.uint8)
    with torch.inference_mode():
        told, untold = telling(frames, 3), network(frames, 3)
    assert untold.angular_velocities is None
    assert torch.equal(told.positions, untold.positions)
    assert torch.equal(told.covariances, untold.covariances)


def test_a_third_ball_is_looked_for_as_the_first_is():
    two, three = field_net(2), field_net(3)
    load_fitting(three, two.state_dict())
    own, known = three.state_dict(), two.state_dict()
    where = "perception.first.where.weight"
    torch.testing.assert_close(own[where], torch.cat([known[where], known[where][:12]]))


def test_a_closer_look_is_judged_where_it_can_see_the_ball():
    seen = torch.zeros(1, 1, 4, 2)
    unused, ground = torch.zeros(1, 1, 3), torch.zeros(1, 3, 32, 32)
    truth = (torch.zeros(1, 1, 9, 3), ground, torch.zeros(1, 2))
    costs = {}
    for lost, place in ((False, 0.2), (True, 0.8)):
        passes = (seen + place, (seen + place + 0.1).requires_grad_(), seen + place)
        centres = torch.zeros(1, 1, 3) + place
        perceived = PerceptionOutput(
            passes, ground, torch.zeros(1, 2), centres, unused, unused, unused
        )
        PerceptionLoss(within_reach=True)(perceived, truth).backward()
        costs[lost] = float(passes[1].grad.abs().sum())
    assert costs[False] > 0
    assert costs[True] == 0
