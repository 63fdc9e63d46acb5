"""The recurrent predictor: encoder, transition, motion, read-outs, composed (paper, section 3)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from rollcast.outputs import OUTPUTS, SPECS, OutputName
from training.networks.blocks import PIXEL_UNIT

ANGULAR_VELOCITY_UNIT = 20.0
"""Angular velocity in rad/s per unit of the networks' read-out, which balances the losses."""

LARGEST_VARIANCE_PX2 = 100.0
SMALLEST_VARIANCE_PX2 = 0.01


class State(NamedTuple):
    """h_t = (s_t, p_t): distributed state [B, N, C, 8, 8] and motion state [B, N, P].

    In networks with an explicit state, s is the ground map [B, 3, G, G].
    """

    s: Tensor
    p: Tensor


class InitialState(NamedTuple):
    """Initial state of a forecast of a network with perception, from frames or true."""

    state: State
    """Ground map, and the state of every ball (``fieldnet.py``)."""
    finals: Tensor | None = None
    """Image points [B, N, 2] of the balls in the final frame, halves of the frame; None without a
    final frame, or if the state contains them."""


class PerceptionOutput(NamedTuple):
    """Outputs of perception (``perception.py``); an observation carries them for their loss.

    Units are halves of the frame in image axes (x right, y down, z towards the camera), frames, and
    20 rad/s.
    """

    seen_positions: tuple[Tensor, ...]
    """Positions [B, N, K, 2] in the observed frames, after each pass: coarse, refined, zoomed."""
    ground: Tensor
    """Map [B, 3, G, G] of the resting heights, see ``training.data.rest_height_map``."""
    scene_constants: Tensor
    """Scene constants [B, 2], see :func:`training.networks.perception.scene_constants_of`."""
    centres: Tensor
    """Positions [B, N, 3] of the centres at t = 0."""
    velocities: Tensor
    """Displacements [B, N, 3] per frame at t = 0."""
    spins: Tensor
    """Angular velocities [B, N, 3] at t = 0, world axes."""
    features: Tensor
    """Features [B, N, F] of the refiner."""
    radii: Tensor | None = None
    """Radii [B, N] of the balls in the frame, for perception with a zoomed refiner."""


class Observation(NamedTuple):
    """Outputs of a state, in 128-pixel units and rad/s; None for outputs the network lacks.

    Shapes are [B, N, 2], [B, N, 2, 2] and [B, N, 3] for one step, with T after N for a rollout. The
    final position [B, N, 2] is an output of h_0 only, once per rollout.
    """

    positions: Tensor
    covariances: Tensor | None
    angular_velocities: Tensor | None
    final_positions: Tensor | None = None
    perception_output: PerceptionOutput | None = None

    def outputs(self) -> dict[OutputName, Tensor]:
        """Return the outputs that the network has, by name, in the order of ``OUTPUTS``."""
        values = {spec.name: getattr(self, spec.name) for spec in OUTPUTS}
        return {name: value for name, value in values.items() if value is not None}


class Motion(Protocol):
    """Initialisation and transition of the motion state p_t."""

    def start(self, s_0: Tensor) -> Tensor:
        """p_0 from s_0."""
        ...

    def move(self, p: Tensor, s: Tensor, s_next: Tensor) -> Tensor:
        """p_{t+1} from p_t, s_t and s_{t+1}."""
        ...


class DirectMotion(nn.Module):
    """p_t = phi_p(aug_xy(s_t)) at every step (PosNet)."""

    def __init__(self, readout: nn.Module) -> None:
        super().__init__()
        self.readout = readout

    def start(self, s_0: Tensor) -> Tensor:
        """p_0 from s_0."""
        return self.readout(s_0)

    def move(self, p: Tensor, s: Tensor, s_next: Tensor) -> Tensor:  # noqa: ARG002
        """p_{t+1} from s_{t+1} alone."""
        return self.readout(s_next)


class IncrementalMotion(nn.Module):
    """p_{t+1} = p_t + phi_p(s_t), with a separate read-out for p_0 (DispNet, ProbNet)."""

    def __init__(self, first: nn.Module, increment: nn.Module) -> None:
        super().__init__()
        self.first = first
        self.increment = increment

    def start(self, s_0: Tensor) -> Tensor:
        """p_0 from s_0."""
        return self.first(s_0)

    def move(self, p: Tensor, s: Tensor, s_next: Tensor) -> Tensor:  # noqa: ARG002
        """p_{t+1} from p_t and s_t."""
        return p + self.increment(s)


class PointOutput(nn.Module):
    """Positions without covariances: p = (x, y)."""

    def forward(self, p_BNP: Tensor) -> tuple[Tensor, None]:
        """Positions, and None for covariances."""
        return pixels(p_BNP[..., :2]), None


class GaussianOutput(nn.Module):
    """Bivariate Gaussian: p = (x, y, beta_1, beta_2, theta) (paper, section 3.3).

    Sigma = R(theta)^T diag(l_1, l_2) R(theta) with eigenvalues l_i = L sigmoid(beta_i) + 0.01.

    Parameters
    ----------
    largest_px2
        L in px^2; 100 in the paper.
    """

    def __init__(self, largest_px2: float = LARGEST_VARIANCE_PX2) -> None:
        super().__init__()
        self.largest_px2 = largest_px2

    def forward(self, p_BNP: Tensor) -> tuple[Tensor, Tensor]:
        """Positions and covariances."""
        eigenvalues = self.largest_px2 * torch.sigmoid(p_BNP[..., 2:4]) + SMALLEST_VARIANCE_PX2
        cos, sin = torch.cos(p_BNP[..., 4]), torch.sin(p_BNP[..., 4])
        one, two = eigenvalues[..., 0], eigenvalues[..., 1]
        xx = one * cos * cos + two * sin * sin
        yy = one * sin * sin + two * cos * cos
        xy = (two - one) * sin * cos
        covariance = torch.stack([xx, xy, xy, yy], dim=-1).unflatten(-1, (2, 2))
        return pixels(p_BNP[..., :2]), covariance


class Head(NamedTuple):
    """Parts that differ between variants: the path from states to positions.

    ``final`` reads the position in the final frame from s_0, for networks with a final frame.
    """

    motion: Motion
    output: nn.Module
    final: nn.Module | None = None


def pixels(position: Tensor) -> Tensor:
    """Convert positions from network units to 128-pixel units."""
    return PIXEL_UNIT + PIXEL_UNIT * position


def logit_of_variance(variance_px2: float, largest_px2: float = LARGEST_VARIANCE_PX2) -> float:
    """Return the beta whose eigenvalue is ``variance_px2``."""
    share = (variance_px2 - SMALLEST_VARIANCE_PX2) / largest_px2
    return math.log(share / (1 - share))


class Network(nn.Module, ABC):
    """Recurrent network: frames to a state, state to state, state to an observation."""

    @abstractmethod
    def start(self, frames_BKHW3: Tensor) -> State:
        """h_0 from the observed frames."""

    @abstractmethod
    def advance(self, state: State) -> State:
        """h_{t+1} from h_t."""

    @abstractmethod
    def observe(self, state: State) -> Observation:
        """Observation y_t of a state."""

    def observe_first(self, state: State) -> Observation:
        """Observation of h_0, which may have more outputs than later ones."""
        return self.observe(state)

    def forward(self, frames_BKHW3: Tensor, horizon: int) -> Observation:
        """Observations of the steps 0..horizon-1, stacked after the objects' axis."""
        return self.roll_out(self.start(frames_BKHW3), horizon)

    def roll_out(self, state: State, horizon: int) -> Observation:
        """Observations of the steps 0..horizon-1, from h_0 on."""
        steps = [self.observe_first(state)]
        for _ in range(horizon - 1):
            state = self.advance(state)
            steps.append(self.observe(state))
        return stacked(steps)


class RecurrentNetwork(Network):
    """Encoder x transition x head x angular velocity.

    Parameters
    ----------
    encoder
        Frames uint8 [B, K, 128, 128, 3] to s_0 [B, N, C, 8, 8].
    transition
        s_t to s_{t+1}.
    head
        Initialisation and transition of p_t; p_t to positions and covariances.
    spin
        s_t to angular velocities in units of 20 rad/s, or None ("w/o ang. vel.").
    """

    def __init__(
        self,
        encoder: nn.Module,
        transition: nn.Module,
        head: Head,
        spin: nn.Module | None,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.transition = transition
        self.motion, self.output, self.final = head
        self.spin = spin

    def start(self, frames_BKHW3: Tensor) -> State:
        """h_0 from the observed frames."""
        s = self.encoder(frames_BKHW3)
        return State(s, self.motion.start(s))

    def advance(self, state: State) -> State:
        """h_{t+1} from h_t."""
        s_next = self.transition(state.s)
        return State(s_next, self.motion.move(state.p, state.s, s_next))

    def observe(self, state: State) -> Observation:
        """Observation y_t of a state."""
        positions, covariances = self.output(state.p)
        return Observation(positions, covariances, self.angular_velocity(state.s))

    def observe_first(self, state: State) -> Observation:
        """Observation (y_0, y_final) of h_0 (paper, section 5.2, interpolation)."""
        return self.observe(state)._replace(final_positions=self.final_position(state.s))

    def final_position(self, s_0: Tensor) -> Tensor | None:
        """Position in the final frame, or None for networks without a final frame."""
        return None if self.final is None else pixels(self.final(s_0))

    def angular_velocity(self, s: Tensor) -> Tensor | None:
        """Angular velocity in rad/s, or None."""
        return None if self.spin is None else ANGULAR_VELOCITY_UNIT * self.spin(s)


class Family(nn.Module):
    """Networks that are trained together.

    Parameters
    ----------
    members
        Networks by name.
    """

    def __init__(self, members: Mapping[str, Network]) -> None:
        super().__init__()
        self.members = nn.ModuleDict(dict(members))

    def networks(self) -> dict[str, Network]:
        """Return the members by name."""
        return {n: one for n, one in self.members.items() if isinstance(one, Network)}

    def shared_parameters(self) -> list[nn.Parameter]:
        """Return the parameters that all members share: none."""
        return []

    def forward(self, frames_BKHW3: Tensor, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return {name: member(frames_BKHW3, horizon) for name, member in self.networks().items()}


class PerceptionFamily(Family, ABC):
    """Networks that also start from an initial state instead of frames: cached or true."""

    @abstractmethod
    def initial_state(self, frames_BKHW3: Tensor) -> InitialState:
        """Return the initial state that perception finds in the frames."""

    @abstractmethod
    def forecast_from(self, initial: InitialState, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""


class SharedStateFamily(Family):
    """Predictors that share encoder, transition and spin read-out, rolled out together.

    Most of the computation is the distributed state, which is the same for all members, so training
    all of them costs little more than training one.

    Parameters
    ----------
    members
        Predictors by name, made of the same encoder, transition and spin modules.
    """

    def __init__(self, members: Mapping[str, RecurrentNetwork]) -> None:
        super().__init__(members)
        first = next(iter(members.values()))
        if any(
            (member.encoder, member.transition, member.spin)
            != (first.encoder, first.transition, first.spin)
            for member in members.values()
        ):
            raise ValueError("the members of a family share encoder, transition and spin read-out")

    def predictors(self) -> dict[str, RecurrentNetwork]:
        """Return the members by name."""
        return {n: one for n, one in self.networks().items() if isinstance(one, RecurrentNetwork)}

    def shared_parameters(self) -> list[nn.Parameter]:
        """Return the parameters of encoder, transition and spin read-out."""
        first = next(iter(self.predictors().values()))
        parts = (first.encoder, first.transition, first.spin)
        return [p for part in parts if part is not None for p in part.parameters()]

    def forward(self, frames_BKHW3: Tensor, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return self.roll_out(next(iter(self.predictors().values())).encoder(frames_BKHW3), horizon)

    def roll_out(self, s: Tensor, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member, from s_0."""
        members = self.predictors()
        shared = next(iter(members.values()))
        motions = {name: member.motion.start(s) for name, member in members.items()}
        steps: dict[str, list[Observation]] = {name: [] for name in members}
        finals = {name: member.final_position(s) for name, member in members.items()}
        for step in range(horizon):
            if step > 0:
                s_next = shared.transition(s)
                for name, member in members.items():
                    motions[name] = member.motion.move(motions[name], s, s_next)
                s = s_next
            spin = shared.angular_velocity(s)
            for name, member in members.items():
                positions, covariances = member.output(motions[name])
                steps[name].append(Observation(positions, covariances, spin, finals[name]))
        return {name: stacked(observed) for name, observed in steps.items()}


def in_float32(observation: Observation) -> Observation:
    """Return an observation whose tensors are float32, for a loss under autocast."""
    return observation._replace(
        **{name: value.float() for name, value in observation.outputs().items()}
    )


def stacked(steps: Sequence[Observation]) -> Observation:
    """Stack the steps' observations after the objects' axis."""
    paths = {
        name: torch.stack([getattr(step, name) for step in steps], dim=2)
        for name in steps[0].outputs()
        if SPECS[name].is_per_step
    }
    return steps[0]._replace(**paths)
