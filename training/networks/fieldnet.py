"""FieldNet: balls with an explicit state, moved over a map of the ground that the eye draws.

A network of ours beside the paper's (decision 0016). Units as in ``eye.py``.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from training.common.precision import full_precision
from training.networks.perception import (
    FEATURES,
    Eye,
    PerceptionNetwork,
    ZoomedLook,
    looked,
    of_each,
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
"""Frames ahead, at the present velocity, at which the ground is felt."""

MESSAGE = 32
"""Numbers that one ball tells another."""

FARTHEST, FASTEST, MOST_SPIN = 2.0, 1.0, 25.0
"""Bounds of a ball's state that no scene comes near: a rollout cannot run away."""

FIRST_VARIANCE_PX2, LARGEST_VARIANCE_PX2 = 2.0, 2500.0
"""The paper's largest, 100 px^2, is too sure on heightfields: errors of 20 px are common there."""

NUMBERS = 3 + 3 + 3 + 3 + 2
"""Of a ball."""


class Ball(NamedTuple):
    """The explicit state of every ball, [..., size] each; p_t is all of it side by side."""

    centre: Tensor
    """[..., 3]."""
    velocity: Tensor
    """[..., 3] a frame."""
    spin: Tensor
    """[..., 3] units of 20 rad/s, world axes."""
    doubt: Tensor
    """[..., 3] (beta_1, beta_2, theta) of the position's Gaussian (paper, section 3.3)."""
    measures: Tensor
    """[..., 2] constants of the scene, see :func:`training.networks.perception.measures_of`."""

    @classmethod
    def unpacked(cls, p: Tensor) -> "Ball":
        """Ball whose numbers stand side by side in the last axis."""
        return cls(*p.split((3, 3, 3, 3, 2), dim=-1))

    def packed(self) -> Tensor:
        """Numbers side by side, [..., 14]."""
        return torch.cat(self, dim=-1)

    @property
    def radius(self) -> Tensor:
        """[..., 1], halves of the frame."""
        return radius_of(self.measures)

    def changed(self, moved: Tensor, pushed: Tensor, turned: Tensor) -> "Ball":
        """Ball whose centre, velocity and spin a network changed, within their bounds."""
        return self._replace(
            centre=(self.centre + 0.1 * moved).clamp(-FARTHEST, FARTHEST),
            velocity=(self.velocity + 0.1 * pushed).clamp(-FASTEST, FASTEST),
            spin=(self.spin + turned).clamp(-MOST_SPIN, MOST_SPIN),
        )


class Course(NamedTuple):
    """How a ball's own way relates to its place in the final frame."""

    final: Tensor
    """[..., 2] where it will be then."""
    miss: Tensor
    """[..., 2] from where it would get by itself to there."""
    passed: Tensor
    """[..., 1] share of the steps until then."""


def unpacked(p: Tensor) -> tuple[Ball, Course | None]:
    """Ball and, where a final frame is seen, its course: p_t."""
    if p.shape[-1] == NUMBERS:
        return Ball.unpacked(p), None
    numbers, *course = p.split((NUMBERS, 2, 2, 1), dim=-1)
    return Ball.unpacked(numbers), Course(*course)


class Encounters(nn.Module):
    """What every ball learns of the others it may meet: the sum of their messages."""

    def __init__(self) -> None:
        super().__init__()
        self.message = nn.Sequential(
            nn.Linear(2 * 3 + 2 * 3 + len(AHEAD) + 1, 96), nn.SiLU(), nn.Linear(96, MESSAGE)
        )

    def forward(self, ball: Ball) -> Tensor:
        """Messages [B, N, MESSAGE]; a ball that is out of reach says nothing."""
        apart = ball.centre[:, None] - ball.centre[:, :, None]
        closing = ball.velocity[:, None] - ball.velocity[:, :, None]
        ahead = torch.tensor(AHEAD, device=apart.device)[:, None]
        ways = apart[..., None, :] + ahead * closing[..., None, :]
        gaps = ways.norm(dim=-1) - self.reach(ball)
        objects = apart.shape[1]
        mine = ball.spin[:, :, None].expand(-1, -1, objects, -1)
        other = ball.spin[:, None].expand(-1, objects, -1, -1)
        size = ball.radius[:, :, None].expand(-1, -1, objects, -1)
        seen = torch.cat(
            [5 * apart, 10 * closing, mine, other, (20 * gaps).clamp(-2, 2), size], dim=-1
        )
        # Balls meet within a frame only when some gap is small; nobody meets itself.
        near = (1 - 10 * gaps.amin(dim=-1, keepdim=True)).clamp(0, 1)
        strangers = 1 - torch.eye(objects, device=apart.device)[..., None]
        return (of_each(self.message, seen) * near * strangers).sum(dim=2)

    def reach(self, ball: Ball) -> Tensor:
        """Distance [B, N, 1 or N, 1] of the centres of two balls that touch."""
        return 2 * ball.radius[:, :, None]


class Rolling(nn.Module):
    """One frame of motion: a perceptron that feels the ground along the way of every ball.

    What a contact needs is laid out for it: gaps and approach speeds against the ground, and how
    far the ball would get beyond the frame's border, where heightfields have elastic walls.
    """

    def __init__(self, encounters: Encounters | None) -> None:
        super().__init__()
        hidden = 256
        self.encounters = encounters
        felt = 3 * 3 + 3 * 2 + 5 * len(AHEAD) + 2 + (MESSAGE if encounters else 0)
        self.layers = nn.Sequential(
            nn.Linear(felt, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU()
        )
        self.change = nn.Linear(hidden, 9)
        # Plain bounces and free rolling are linear in what is felt.
        self.linear = nn.Linear(felt, 9, bias=False)
        # Doubt listens without changing what is said of the positions.
        self.doubt = nn.Sequential(nn.Linear(felt + 3, 64), nn.SiLU(), nn.Linear(64, 3))
        for last in (self.change, self.linear, self.doubt[-1]):
            assert isinstance(last, nn.Linear)
            for parameter in last.parameters():
                nn.init.zeros_(parameter)

    def forward(self, ball: Ball, ground_B3GG: Tensor) -> Ball:
        """Balls [B, N, ...] a frame later."""
        felt = self._felt(ball, ground_B3GG)
        change = of_each(self.change, of_each(self.layers, felt)) + of_each(self.linear, felt)
        moved, pushed, turned = change.split(3, dim=-1)
        doubting = torch.cat([ball.doubt, felt], dim=-1).detach()
        doubt = ball.doubt + of_each(self.doubt, doubting)
        rolled = ball._replace(centre=ball.centre + ball.velocity, doubt=doubt)
        return rolled.changed(moved, pushed, turned)

    def _felt(self, ball: Ball, ground_B3GG: Tensor) -> Tensor:
        """Numbers [B, N, felt] that the perceptrons work on."""
        velocity, flat = ball.velocity, ball.velocity[..., :2]
        border = 1 - ball.radius
        there = ball.centre[..., :2] + flat
        beyond = there - torch.minimum(torch.maximum(there, -border), border)
        hit = (500 * beyond.abs()).clamp(max=1)
        ahead = torch.tensor(AHEAD, device=velocity.device)[:, None]
        way = ball.centre[..., None, :] + ahead * velocity[..., None, :]
        under = sampled(ground_B3GG, way[..., :2])
        lean, height = under[..., :2], under[..., 2]
        upright = (1 - lean.square().sum(dim=-1)).clamp(min=1e-3).sqrt()
        gap = (20 * (way[..., 2] - height - ball.radius)).clamp(-2, 2)
        rising = (flat[..., None, :] * lean).sum(dim=-1) + velocity[..., 2:] * upright
        known = [
            ball.centre, 10 * velocity, ball.spin, 10 * beyond, hit, 10 * hit * flat,
            lean[..., 0], lean[..., 1], upright, gap, 20 * rising, ball.measures,
        ]  # fmt: skip
        if self.encounters is not None:
            known.append(self.encounters(ball))
        return torch.cat(known, dim=-1)


class Bend(nn.Module):
    """Bends a ball's own way so that it ends at its final place.

    With a share u of the steps passed and a miss m at the end, the way moves by
    u^2 m + u (1 - u) (G m + |m| g): nothing at first, all of m at the end. A perceptron says G and
    g, so a way that would end well is left alone.
    """

    def __init__(self) -> None:
        super().__init__()
        hidden = 128
        known = 2 + 2 + 2 + 3 + 3 + 3 + 2 + 2 * 3 + 2
        self.layers = nn.Sequential(
            nn.Linear(known, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU()
        )
        self.change = nn.Linear(hidden, 4 + 2 + 3)
        # Doubt listens without changing what is said of the positions.
        self.doubt = nn.Sequential(nn.Linear(known + 3, 64), nn.SiLU(), nn.Linear(64, 3))
        for last in (self.change, self.doubt[-1]):
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, ball: Ball, ground_B3GG: Tensor, course: Course) -> Ball:
        """Balls [B, N, ...] where they are on their bent ways."""
        known = self._known(ball, ground_B3GG, course)
        change = of_each(self.change, of_each(self.layers, known))
        gain, aside, turned = change.split((4, 2, 3), dim=-1)
        doubting = torch.cat([ball.doubt, known], dim=-1).detach()
        u, miss = course.passed, course.miss
        size = miss.norm(dim=-1, keepdim=True)
        between = (gain.unflatten(-1, (2, 2)) * miss[..., None, :]).sum(dim=-1) + size * aside
        moved = u.square() * miss + u * (1 - u) * between
        return ball._replace(
            centre=torch.cat([ball.centre[..., :2] + moved, ball.centre[..., 2:]], dim=-1),
            spin=ball.spin + size * turned,
            doubt=ball.doubt + of_each(self.doubt, doubting),
        )

    def _known(self, ball: Ball, ground_B3GG: Tensor, course: Course) -> Tensor:
        """Numbers [B, N, known] that the perceptrons work on."""
        u, miss = course.passed, course.miss
        size = miss.norm(dim=-1, keepdim=True)
        straight = ball.centre[..., :2] + u * miss
        places = torch.stack([ball.centre[..., :2], straight], dim=-2)
        known = [
            u, u.square(), miss, (5 * size).clamp(max=1.5), 0.3 * (size + 1e-3).log(),
            ball.centre, 10 * ball.velocity, ball.spin, ball.measures,
            sampled(ground_B3GG, places).flatten(-2), course.final,
        ]  # fmt: skip
        return torch.cat(known, dim=-1)


class FieldNet(PerceptionNetwork):
    """Eye x rolling: s_t is the map of the ground, which stays, and p_t the balls' states.

    With a final frame, p_t also carries each ball's course, and what is observed is bent to it.
    Without angular velocities the state has them still, as numbers that nobody taught and that are
    not observed: footage does not tell them.
    """

    def __init__(self, task: Task, zoomed: ZoomedLook | None = None) -> None:
        super().__init__()
        self.final_step = task.final_step
        self.tells_spin = task.angular_velocity
        self.eye = Eye(task.objects, zoomed)
        self.rolling = Rolling(Encounters() if task.meetings else None)
        self.bend = None if task.final_step is None else Bend()
        self.first_doubt = nn.Linear(FEATURES, 3)
        nn.init.zeros_(self.first_doubt.weight)
        with torch.no_grad():
            self.first_doubt.bias[:] = torch.tensor(
                [logit_of_variance(FIRST_VARIANCE_PX2, LARGEST_VARIANCE_PX2)] * 2 + [0.0]
            )
        self.output = GaussianOutput(LARGEST_VARIANCE_PX2)

    def start(self, frames_BKHW3: Tensor) -> State:
        """h_0 from the seen frames."""
        return self._look(frames_BKHW3)[0]

    def _look(
        self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
    ) -> tuple[State, PerceptionOutput]:
        reading, finals = looked(self.eye, frames_BKHW3, prompts_BN2)
        return self.begin(reading, finals), reading

    def begin(self, reading: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from what the eye read."""
        with full_precision(reading.ground.device):
            doubt = of_each(self.first_doubt, reading.features.detach())
        return self.aimed(seen_state(reading, doubt), finals_BN2)

    def aimed(self, state: State, finals_BN2: Tensor | None) -> State:
        """State whose balls also carry their courses, where the final frame is known."""
        if finals_BN2 is None:
            return state
        assert self.final_step is not None
        ball = Ball.unpacked(state.p)
        for _ in range(self.final_step):
            ball = self.rolling(ball, state.s)
        course = Course(
            finals_BN2, finals_BN2 - ball.centre[..., :2], torch.zeros_like(ball.doubt[..., :1])
        )
        return State(state.s, torch.cat([state.p, *course], dim=-1))

    def advance(self, state: State) -> State:
        """h_{t+1} from h_t."""
        ball, course = unpacked(state.p)
        moved = self.rolling(ball, state.s).packed()
        if course is None or self.final_step is None:
            return State(state.s, moved)
        course = course._replace(passed=course.passed + 1 / self.final_step)
        return State(state.s, torch.cat([moved, *course], dim=-1))

    def observe(self, state: State) -> Observation:
        """Observation y_t of a state."""
        ball, course = unpacked(state.p)
        if course is not None and self.bend is not None:
            ball = self.bend(ball, state.s, course)
        positions, covariances = self.output(torch.cat([ball.centre[..., :2], ball.doubt], dim=-1))
        spins = ANGULAR_VELOCITY_UNIT * ball.spin if self.tells_spin else None
        return Observation(positions, covariances, spins)

    def observe_first(self, state: State) -> Observation:
        """Observation of h_0, with the final position where a frame shows it."""
        seen, (_, course) = self.observe(state), unpacked(state.p)
        return seen if course is None else seen._replace(final_positions=pixels(course.final))

    def forward(
        self, frames_BKHW3: Tensor, horizon: int, prompts_BN2: Tensor | None = None
    ) -> Observation:
        """Observations of the steps 0..horizon-1, and what the eye read, for its own loss.

        Parameters
        ----------
        prompts_BN2
            See :meth:`training.networks.perception.Eye.forward`.
        """
        state, reading = self._look(frames_BKHW3, prompts_BN2)
        with full_precision(state.s.device):
            return self.roll_out(state, horizon)._replace(reading=reading)

    def forecast_from(self, state: State, horizon: int) -> tuple[Tensor, Tensor]:
        """Centres [B, N, T, 3] and angular velocities [B, N, T, 3] in rad/s from a state on."""
        balls = [Ball.unpacked(state.p)]
        for _ in range(horizon - 1):
            balls.append(self.rolling(balls[-1], state.s))
        centres = torch.stack([ball.centre for ball in balls], dim=2)
        spins = torch.stack([ball.spin for ball in balls], dim=2)
        return centres, ANGULAR_VELOCITY_UNIT * spins


def seen_state(reading: PerceptionOutput, doubt_BN3: Tensor) -> State:
    """State at t = 0 from what an eye read."""
    measures = reading.measures[:, None].expand(-1, reading.centres.shape[1], -1)
    ball = Ball(reading.centres, reading.velocities, reading.spins, doubt_BN3, measures)
    return State(reading.ground, ball.packed())


def true_state(
    centres_BNK3: Tensor, spins_BN3: Tensor, ground_B3GG: Tensor, measures_B2: Tensor
) -> State:
    """State at t = 0 from the truth. An impact makes its velocity, the last displacement, wrong.

    Parameters
    ----------
    centres_BNK3
        Centres in the seen frames.
    spins_BN3
        Angular velocities at t = 0, rad/s.
    ground_B3GG
        NaN where no ball can rest.
    """
    now, before = centres_BNK3[:, :, -1], centres_BNK3[:, :, -2]
    measures = measures_B2[:, None].expand(-1, now.shape[1], -1)
    spins = spins_BN3 / ANGULAR_VELOCITY_UNIT
    ball = Ball(now, now - before, spins, torch.zeros_like(now), measures)
    return State(ground_B3GG.nan_to_num(), ball.packed())


class FieldFamily(PerceptionFamily):
    """Networks with an explicit state; a network of several has an eye of its own."""

    def forward(
        self, frames_BKHW3: Tensor, horizon: int, prompts_BN2: Tensor | None = None
    ) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return {
            name: network(frames_BKHW3, horizon, prompts_BN2)
            for name, network in self.networks().items()
        }

    def sight(self, frames_BKHW3: Tensor) -> InitialState:
        """Return what the eye of the only network reads of the frames."""
        (network,) = self.networks().values()
        return InitialState(network.start(frames_BKHW3))

    def forecast_from(self, sight: InitialState, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        with full_precision(sight.state.p.device):
            return {
                name: network.roll_out(sight.state, horizon)
                for name, network in self.networks().items()
            }


def field_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make networks of the field preset (see :class:`training.networks.presets.Preset`).

    Raises
    ------
    ValueError
        For another variant, or without angular velocities.
    """
    _require_fieldnet(variants)
    return FieldFamily({name: FieldNet(task) for name in variants})


def zoomed_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make networks of the zoomed preset: the eye of the field preset looks once more."""
    _require_fieldnet(variants)
    return FieldFamily({name: FieldNet(task, ZoomedLook()) for name in variants})


def _require_fieldnet(variants: Mapping[str, str]) -> None:
    if set(variants.values()) != {"fieldnet"}:
        raise ValueError(
            f"the field presets make fieldnet alone, not {', '.join(variants.values())}"
        )
