"""FieldNet: balls with an explicit state that roll over a predicted ground map.

The paper has no such network (decision 0016). Units as in ``perception.py``.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from training.common.precision import full_precision
from training.networks.perception import (
    FEATURES,
    Perception,
    PerceptionNetwork,
    ZoomedRefiner,
    of_each,
    perceive,
    radius_of,
    sampled,
)
from training.networks.recurrent import (
    ANGULAR_VELOCITY_UNIT,
    Family,
    GaussianOutput,
    InitialState,
    Observation,
    PerceptionFamily,
    PerceptionOutput,
    State,
    logit_of_variance,
    pixels,
)
from training.networks.task import Task

AHEAD = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Offsets in frames, at the current velocity, at which the ground map is sampled."""

MESSAGE = 32
"""Size of the message from one ball to another."""

FARTHEST, FASTEST, MOST_SPIN = 2.0, 1.0, 25.0
"""Bounds of the components of a ball's state, far beyond any scene: a rollout cannot diverge."""

FIRST_VARIANCE_PX2, LARGEST_VARIANCE_PX2 = 2.0, 2500.0
"""Initial and largest variance of a position.

The paper's maximum, 100 px^2, is too small on heightfields, where errors of 20 px are common.
"""

NUMBERS = 3 + 3 + 3 + 3 + 2
"""Size of the state of a ball."""


class Ball(NamedTuple):
    """Explicit state of every ball, [..., size] each; p_t is their concatenation."""

    centre: Tensor
    """Position [..., 3] of the centre."""
    velocity: Tensor
    """Displacement [..., 3] per frame."""
    spin: Tensor
    """Angular velocity [..., 3] in units of 20 rad/s, world axes."""
    covariance_params: Tensor
    """Parameters [..., 3] (beta_1, beta_2, theta) of the position's covariance (paper, 3.3)."""
    scene_constants: Tensor
    """Scene constants [..., 2], see :func:`training.networks.perception.scene_constants_of`."""

    @classmethod
    def unpacked(cls, p: Tensor) -> "Ball":
        """Split the last axis [..., 14] into the parts of the state."""
        return cls(*p.split((3, 3, 3, 3, 2), dim=-1))

    def packed(self) -> Tensor:
        """Concatenate the parts of the state to [..., 14]."""
        return torch.cat(self, dim=-1)

    @property
    def radius(self) -> Tensor:
        """Radius [..., 1], halves of the frame."""
        return radius_of(self.scene_constants)

    def changed(self, moved: Tensor, pushed: Tensor, turned: Tensor) -> "Ball":
        """Add a network's scaled outputs to centre, velocity and spin, clamped to their bounds."""
        return self._replace(
            centre=(self.centre + 0.1 * moved).clamp(-FARTHEST, FARTHEST),
            velocity=(self.velocity + 0.1 * pushed).clamp(-FASTEST, FASTEST),
            spin=(self.spin + turned).clamp(-MOST_SPIN, MOST_SPIN),
        )


class EndpointTarget(NamedTuple):
    """Position of a ball in the final frame, relative to its uncorrected rollout."""

    final: Tensor
    """Position [..., 2] in the final frame."""
    miss: Tensor
    """Displacement [..., 2] from the end of the uncorrected rollout to ``final``."""
    passed: Tensor
    """Fraction [..., 1] of the steps until the final frame that have passed."""


def unpacked(p: Tensor) -> tuple[Ball, EndpointTarget | None]:
    """Split p_t into the ball and, for networks with a final frame, its target."""
    if p.shape[-1] == NUMBERS:
        return Ball.unpacked(p), None
    numbers, *target = p.split((NUMBERS, 2, 2, 1), dim=-1)
    return Ball.unpacked(numbers), EndpointTarget(*target)


class PairInteraction(nn.Module):
    """Pair interaction: the sum of the messages that each ball receives from nearby balls."""

    def __init__(self) -> None:
        super().__init__()
        self.message = nn.Sequential(
            nn.Linear(2 * 3 + 2 * 3 + len(AHEAD) + 1, 96), nn.SiLU(), nn.Linear(96, MESSAGE)
        )

    def forward(self, ball: Ball) -> Tensor:
        """Messages [B, N, MESSAGE]; balls that cannot touch within a frame contribute zero."""
        apart = ball.centre[:, None] - ball.centre[:, :, None]
        closing = ball.velocity[:, None] - ball.velocity[:, :, None]
        ahead = torch.tensor(AHEAD, device=apart.device)[:, None]
        separations = apart[..., None, :] + ahead * closing[..., None, :]
        gaps = separations.norm(dim=-1) - self.reach(ball)
        objects = apart.shape[1]
        mine = ball.spin[:, :, None].expand(-1, -1, objects, -1)
        other = ball.spin[:, None].expand(-1, objects, -1, -1)
        size = ball.radius[:, :, None].expand(-1, -1, objects, -1)
        inputs = torch.cat(
            [5 * apart, 10 * closing, mine, other, (20 * gaps).clamp(-2, 2), size], dim=-1
        )
        # Balls touch within a frame only when some gap is small; the diagonal is no pair.
        near = (1 - 10 * gaps.amin(dim=-1, keepdim=True)).clamp(0, 1)
        pairs = 1 - torch.eye(objects, device=apart.device)[..., None]
        return (of_each(self.message, inputs) * near * pairs).sum(dim=2)

    def reach(self, ball: Ball) -> Tensor:
        """Distance [B, N, 1 or N, 1] between the centres of two touching balls."""
        return 2 * ball.radius[:, :, None]


class Rolling(nn.Module):
    """Transition of one frame: a perceptron on the ground features along every ball's path.

    The inputs contain the quantities of a contact: gaps to the ground, approach speeds, and the
    overshoot beyond the frame's border, where heightfields have elastic walls.
    """

    def __init__(self, pair_interaction: PairInteraction | None) -> None:
        super().__init__()
        hidden = 256
        self.pair_interaction = pair_interaction
        size = 3 * 3 + 3 * 2 + 5 * len(AHEAD) + 2 + (MESSAGE if pair_interaction else 0)
        self.layers = nn.Sequential(
            nn.Linear(size, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU()
        )
        self.change = nn.Linear(hidden, 9)
        # Plain bounces and free rolling are linear in the inputs.
        self.linear = nn.Linear(size, 9, bias=False)
        # The inputs of the covariance parameters are detached: positions do not learn from them.
        self.covariance_change = nn.Sequential(nn.Linear(size + 3, 64), nn.SiLU(), nn.Linear(64, 3))
        for last in (self.change, self.linear, self.covariance_change[-1]):
            assert isinstance(last, nn.Linear)
            for parameter in last.parameters():
                nn.init.zeros_(parameter)

    def forward(self, ball: Ball, ground_B3GG: Tensor) -> Ball:
        """Balls [B, N, ...] one frame later."""
        inputs = self._inputs(ball, ground_B3GG)
        change = of_each(self.change, of_each(self.layers, inputs)) + of_each(self.linear, inputs)
        moved, pushed, turned = change.split(3, dim=-1)
        detached = torch.cat([ball.covariance_params, inputs], dim=-1).detach()
        params = ball.covariance_params + of_each(self.covariance_change, detached)
        rolled = ball._replace(centre=ball.centre + ball.velocity, covariance_params=params)
        return rolled.changed(moved, pushed, turned)

    def trajectory(self, state: State, horizon: int) -> list[Ball]:
        """Balls [B, N, ...] at the steps 0..horizon-1, from a state without a final frame on."""
        balls = [Ball.unpacked(state.p)]
        for _ in range(horizon - 1):
            balls.append(self(balls[-1], state.s))
        return balls

    def _inputs(self, ball: Ball, ground_B3GG: Tensor) -> Tensor:
        """Return the inputs [B, N, size] of the perceptrons."""
        velocity, flat = ball.velocity, ball.velocity[..., :2]
        border = 1 - ball.radius
        next_xy = ball.centre[..., :2] + flat
        beyond = next_xy - torch.minimum(torch.maximum(next_xy, -border), border)
        hit = (500 * beyond.abs()).clamp(max=1)
        ahead = torch.tensor(AHEAD, device=velocity.device)[:, None]
        path = ball.centre[..., None, :] + ahead * velocity[..., None, :]
        ground_features = sampled(ground_B3GG, path[..., :2])
        normal_xy, height = ground_features[..., :2], ground_features[..., 2]
        normal_z = (1 - normal_xy.square().sum(dim=-1)).clamp(min=1e-3).sqrt()
        gap = (20 * (path[..., 2] - height - ball.radius)).clamp(-2, 2)
        rising = (flat[..., None, :] * normal_xy).sum(dim=-1) + velocity[..., 2:] * normal_z
        inputs = [
            ball.centre, 10 * velocity, ball.spin, 10 * beyond, hit, 10 * hit * flat,
            normal_xy[..., 0], normal_xy[..., 1], normal_z, gap, 20 * rising, ball.scene_constants,
        ]  # fmt: skip
        if self.pair_interaction is not None:
            inputs.append(self.pair_interaction(ball))
        return torch.cat(inputs, dim=-1)


class EndpointCorrection(nn.Module):
    """Correction that moves a rollout so that it ends at the position in the final frame.

    With a fraction u of the steps passed and a miss m at the end, the correction is
    u^2 m + u (1 - u) (G m + |m| g): zero at the start, m at the end. A perceptron predicts G and g.
    A rollout with m = 0 is not changed.
    """

    def __init__(self) -> None:
        super().__init__()
        hidden = 128
        size = 2 + 2 + 2 + 3 + 3 + 3 + 2 + 2 * 3 + 2
        self.layers = nn.Sequential(
            nn.Linear(size, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU()
        )
        self.change = nn.Linear(hidden, 4 + 2 + 3)
        # As in Rolling, positions do not learn from the covariance parameters.
        self.covariance_change = nn.Sequential(nn.Linear(size + 3, 64), nn.SiLU(), nn.Linear(64, 3))
        for last in (self.change, self.covariance_change[-1]):
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, ball: Ball, ground_B3GG: Tensor, target: EndpointTarget) -> Ball:
        """Balls [B, N, ...] of a step, corrected."""
        inputs = self._inputs(ball, ground_B3GG, target)
        change = of_each(self.change, of_each(self.layers, inputs))
        gain, aside, turned = change.split((4, 2, 3), dim=-1)
        detached = torch.cat([ball.covariance_params, inputs], dim=-1).detach()
        u, miss = target.passed, target.miss
        size = miss.norm(dim=-1, keepdim=True)
        between = (gain.unflatten(-1, (2, 2)) * miss[..., None, :]).sum(dim=-1) + size * aside
        moved = u.square() * miss + u * (1 - u) * between
        return ball._replace(
            centre=torch.cat([ball.centre[..., :2] + moved, ball.centre[..., 2:]], dim=-1),
            spin=ball.spin + size * turned,
            covariance_params=ball.covariance_params + of_each(self.covariance_change, detached),
        )

    def _inputs(self, ball: Ball, ground_B3GG: Tensor, target: EndpointTarget) -> Tensor:
        """Return the inputs [B, N, size] of the perceptrons."""
        u, miss = target.passed, target.miss
        size = miss.norm(dim=-1, keepdim=True)
        straight = ball.centre[..., :2] + u * miss
        places = torch.stack([ball.centre[..., :2], straight], dim=-2)
        inputs = [
            u, u.square(), miss, (5 * size).clamp(max=1.5), 0.3 * (size + 1e-3).log(),
            ball.centre, 10 * ball.velocity, ball.spin, ball.scene_constants,
            sampled(ground_B3GG, places).flatten(-2), target.final,
        ]  # fmt: skip
        return torch.cat(inputs, dim=-1)


class FieldNet(PerceptionNetwork):
    """Perception and transition: s_t is the constant ground map, p_t the states of the balls.

    With a final frame, p_t also contains the target of each ball, and observations are corrected
    towards it. Without angular velocities in the task, the state still has them, untrained and
    not observed, as footage has no labels for them.

    Parameters
    ----------
    task
        Inputs and outputs of the network.
    zoomed
        Refiner that measures radii, or None.
    """

    def __init__(self, task: Task, zoomed: ZoomedRefiner | None = None) -> None:
        super().__init__()
        self.final_step = task.final_step
        self.tells_spin = task.angular_velocity
        self.perception = Perception(task.objects, zoomed)
        self.rolling = Rolling(PairInteraction() if task.meetings else None)
        self.endpoint_correction = None if task.final_step is None else EndpointCorrection()
        self.first_covariance = nn.Linear(FEATURES, 3)
        nn.init.zeros_(self.first_covariance.weight)
        with torch.no_grad():
            self.first_covariance.bias[:] = torch.tensor(
                [logit_of_variance(FIRST_VARIANCE_PX2, LARGEST_VARIANCE_PX2)] * 2 + [0.0]
            )
        self.output = GaussianOutput(LARGEST_VARIANCE_PX2)

    def start(self, frames_BKHW3: Tensor) -> State:
        """h_0 from the observed frames."""
        return self._perceive(frames_BKHW3)[0]

    def _perceive(
        self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
    ) -> tuple[State, PerceptionOutput]:
        perceived, finals = perceive(self.perception, frames_BKHW3, prompts_BN2)
        return self.begin(perceived, finals), perceived

    def begin(self, perceived: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from the outputs of perception."""
        with full_precision(perceived.ground.device):
            params = of_each(self.first_covariance, perceived.features.detach())
        return self.aimed(seen_state(perceived, params), finals_BN2)

    def aimed(self, state: State, finals_BN2: Tensor | None) -> State:
        """Append the targets of the balls to a state, if there are positions in a final frame."""
        if finals_BN2 is None:
            return state
        assert self.final_step is not None
        ball = Ball.unpacked(state.p)
        for _ in range(self.final_step):
            ball = self.rolling(ball, state.s)
        place = ball.centre[..., :2]
        target = EndpointTarget(finals_BN2, finals_BN2 - place, torch.zeros_like(place[..., :1]))
        return State(state.s, torch.cat([state.p, *target], dim=-1))

    def advance(self, state: State) -> State:
        """h_{t+1} from h_t."""
        ball, target = unpacked(state.p)
        moved = self.rolling(ball, state.s).packed()
        if target is None or self.final_step is None:
            return State(state.s, moved)
        target = target._replace(passed=target.passed + 1 / self.final_step)
        return State(state.s, torch.cat([moved, *target], dim=-1))

    def observe(self, state: State) -> Observation:
        """Observation y_t of a state."""
        ball, target = unpacked(state.p)
        if target is not None and self.endpoint_correction is not None:
            ball = self.endpoint_correction(ball, state.s, target)
        numbers = torch.cat([ball.centre[..., :2], ball.covariance_params], dim=-1)
        positions, covariances = self.output(numbers)
        spins = ANGULAR_VELOCITY_UNIT * ball.spin if self.tells_spin else None
        return Observation(positions, covariances, spins)

    def observe_first(self, state: State) -> Observation:
        """Observation of h_0, with the final position for networks with a final frame."""
        first, (_, target) = self.observe(state), unpacked(state.p)
        return first if target is None else first._replace(final_positions=pixels(target.final))

    def forward(
        self, frames_BKHW3: Tensor, horizon: int, prompts_BN2: Tensor | None = None
    ) -> Observation:
        """Observations of the steps 0..horizon-1, with the perception outputs for their loss.

        Parameters
        ----------
        prompts_BN2
            See :meth:`training.networks.perception.Perception.forward`.
        """
        state, perceived = self._perceive(frames_BKHW3, prompts_BN2)
        with full_precision(state.s.device):
            return self.roll_out(state, horizon)._replace(perception_output=perceived)

    def forecast_from(self, state: State, horizon: int) -> tuple[Tensor, Tensor]:
        """Centres [B, N, T, 3] and angular velocities [B, N, T, 3] in rad/s, from a state on."""
        balls = self.rolling.trajectory(state, horizon)
        centres = torch.stack([ball.centre for ball in balls], dim=2)
        spins = torch.stack([ball.spin for ball in balls], dim=2)
        return centres, ANGULAR_VELOCITY_UNIT * spins


def seen_state(perceived: PerceptionOutput, covariance_params_BN3: Tensor) -> State:
    """State at t = 0 from the outputs of perception."""
    constants = perceived.scene_constants[:, None].expand(-1, perceived.centres.shape[1], -1)
    ball = Ball(
        perceived.centres, perceived.velocities, perceived.spins, covariance_params_BN3, constants
    )
    return State(perceived.ground, ball.packed())


def true_state(
    centres_BNK3: Tensor, spins_BN3: Tensor, ground_B3GG: Tensor, scene_constants_B2: Tensor
) -> State:
    """State at t = 0 from the true trajectory.

    The velocity is the last displacement, which is wrong after an impact in the last frame.

    Parameters
    ----------
    centres_BNK3
        Centres in the observed frames.
    spins_BN3
        Angular velocities at t = 0, rad/s.
    ground_B3GG
        Ground map, NaN where no ball can rest.
    scene_constants_B2
        Scene constants.
    """
    now, before = centres_BNK3[:, :, -1], centres_BNK3[:, :, -2]
    constants = scene_constants_B2[:, None].expand(-1, now.shape[1], -1)
    spins = spins_BN3 / ANGULAR_VELOCITY_UNIT
    ball = Ball(now, now - before, spins, torch.zeros_like(now), constants)
    return State(ground_B3GG.nan_to_num(), ball.packed())


class FieldFamily(PerceptionFamily):
    """Networks with an explicit state; each member has its own perception."""

    def forward(
        self, frames_BKHW3: Tensor, horizon: int, prompts_BN2: Tensor | None = None
    ) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return {
            name: network(frames_BKHW3, horizon, prompts_BN2)
            for name, network in self.networks().items()
        }

    def initial_state(self, frames_BKHW3: Tensor) -> InitialState:
        """Return the initial state that the only member's perception finds in the frames."""
        (network,) = self.networks().values()
        return InitialState(network.start(frames_BKHW3))

    def forecast_from(self, initial: InitialState, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        with full_precision(initial.state.p.device):
            return {
                name: network.roll_out(initial.state, horizon)
                for name, network in self.networks().items()
            }


def field_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make networks of the field preset (see :class:`training.networks.presets.Preset`).

    Raises
    ------
    ValueError
        If a variant is not ``fieldnet``.
    """
    _require_fieldnet(variants)
    return FieldFamily({name: FieldNet(task) for name in variants})


def zoomed_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make networks of the zoomed preset: the field preset with a refiner that measures radii."""
    _require_fieldnet(variants)
    return FieldFamily({name: FieldNet(task, ZoomedRefiner()) for name in variants})


def _require_fieldnet(variants: Mapping[str, str]) -> None:
    if set(variants.values()) != {"fieldnet"}:
        raise ValueError(
            f"the field presets only have the variant fieldnet, not {', '.join(variants.values())}"
        )
