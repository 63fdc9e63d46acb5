"""The preset perception_init: a convolutional state initialised from the outputs of perception.

Perception is FieldNet's (``perception.py``), pretrained. Ground map and ball states are spread over
8 x 8 cells. From there on the state is learned, as in the compact preset, whose heads are reused.
True states can be spread in the same way, so transition and heads also train without images.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.common.precision import full_precision
from training.networks.blocks import (
    GRID,
    ChannelNorm,
    ObjectInteraction,
    cell_centres,
)
from training.networks.compact import CHANNELS, composed
from training.networks.fieldnet import Ball, seen_state
from training.networks.perception import Perception, PerceptionNetwork, perceive
from training.networks.recurrent import (
    Family,
    InitialState,
    Observation,
    PerceptionFamily,
    PerceptionOutput,
    RecurrentNetwork,
    SharedStateFamily,
    State,
)
from training.networks.task import Task

FOLD = 4
"""Cells of the ground map (32 x 32) per cell of the state (8 x 8), along each side."""


class Spread(nn.Module):
    """Ground map and ball states to s_0 [B, N, C, 8, 8].

    The inputs of a cell are its part of the ground map, the ball's state, and the ball's position
    relative to the cell.

    Parameters
    ----------
    channels
        Channels C of the state.
    final
        Presence of a final frame in the input.
    """

    places: Tensor

    def __init__(self, channels: int, *, final: bool) -> None:
        super().__init__()
        self.register_buffer("places", cell_centres(), persistent=False)
        points = 2 if final else 1
        size = 3 * FOLD**2 + 2 + 2 + 2 * 7 + points * (2 + 1)
        self.layers = nn.Sequential(
            nn.Conv2d(size, channels, 1), nn.ReLU(), nn.Conv2d(channels, channels, 1)
        )
        self.norm = ChannelNorm()

    def forward(self, initial: InitialState) -> Tensor:
        """s_0 of an initial state."""
        ball = Ball.unpacked(initial.state.p)
        numbers = torch.cat([ball.centre[..., 2:], 10 * ball.velocity, ball.spin], dim=-1)
        everywhere = torch.cat([numbers, ball.scene_constants], dim=-1)[..., None, None]
        batch, objects = everywhere.shape[:2]
        ground = functional.pixel_unshuffle(initial.state.s, FOLD)[:, None]
        relative = self._from_cells(ball.centre[..., :2])
        inputs = [
            ground.expand(-1, objects, -1, -1, -1),
            everywhere.expand(-1, -1, -1, GRID, GRID),
            self.places.expand(batch, objects, -1, -1, -1),
            relative,
            relative[:, :, 2:] * numbers[..., None, None],
            *([] if initial.finals is None else [self._from_cells(initial.finals)]),
        ]
        cells = torch.cat(inputs, dim=2).flatten(0, 1)
        return self.norm(self.layers(cells)).unflatten(0, (batch, objects))

    def _from_cells(self, points_BN2: Tensor) -> Tensor:
        """Offset from every cell to a point, in cells, and proximity [B, N, 3, 8, 8]."""
        offset = (points_BN2[..., None, None] - self.places) * (GRID / 2)
        near = (-0.5 * offset.square().sum(dim=2, keepdim=True)).exp()
        return torch.cat([offset, near], dim=2)


class PerceptionStateEncoder(nn.Module):
    """Frames to s_0 through a pretrained perception.

    Parameters
    ----------
    task
        Inputs and outputs of the network.
    channels
        Channels of the state.
    """

    def __init__(self, task: Task, channels: int) -> None:
        super().__init__()
        self.perception = Perception(task.objects)
        self.spread = Spread(channels, final=task.final_step is not None)

    def forward(self, frames_BKHW3: Tensor) -> Tensor:
        """Frames uint8 to s_0."""
        return self.begin(self.initial_state(frames_BKHW3))

    def initial_state(self, frames_BKHW3: Tensor) -> InitialState:
        """Return the initial state that perception finds in the frames."""
        return initial_state_of(*perceive(self.perception, frames_BKHW3))

    def begin(self, initial: InitialState) -> Tensor:
        """s_0 of an initial state, from perception or true."""
        with full_precision(initial.state.p.device):
            return self.spread(initial)


def initial_state_of(perceived: PerceptionOutput, finals_BN2: Tensor | None) -> InitialState:
    """Return the initial state of a forecast; its covariance parameters are zero and not used."""
    return InitialState(seen_state(perceived, torch.zeros_like(perceived.centres)), finals_BN2)


class AttendedTransition(nn.Module):
    """s_{t+1} = phi_s(s_t): convolutions, and a perceptron with attention over the cells.

    Convolutions compute local changes. A ball's motion depends on a few values of a few cells: the
    perceptron gathers them with one softmax over the cells and writes its output with another.

    Parameters
    ----------
    channels
        Channels of the state.
    interaction
        Interaction between balls; None moves each ball independently.
    """

    places: Tensor
    points = 4
    """Number of positions at which a state is read and written."""

    def __init__(self, channels: int, interaction: ObjectInteraction | None = None) -> None:
        super().__init__()
        narrow, wide = 64, 256
        self.interaction = interaction
        self.register_buffer("places", cell_centres()[None], persistent=False)
        inputs = channels if interaction is None else 2 * channels
        self.first = nn.Conv2d(inputs, narrow, 3, padding=1)
        self.second = nn.Conv2d(narrow, channels, 3, padding=1)
        self.where = nn.Sequential(
            nn.Conv2d(inputs + 2, narrow, 1), nn.ReLU(), nn.Conv2d(narrow, 2 * self.points, 1)
        )
        self.answer = nn.Sequential(
            nn.Linear(self.points * inputs, wide), nn.SiLU(),
            nn.Linear(wide, wide), nn.SiLU(),
            nn.Linear(wide, self.points * channels),
        )  # fmt: skip
        for last in (self.second, self.answer[-1]):
            assert isinstance(last, nn.Conv2d | nn.Linear)
            nn.init.normal_(last.weight, std=1e-3)
        self.norm = ChannelNorm()

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """s_t to s_{t+1}."""
        batch, objects = s_BNCHW.shape[:2]
        s = s_BNCHW.flatten(0, 1)
        inputs = s if self.interaction is None else self.interaction(s_BNCHW).flatten(0, 1)
        change = self.second(functional.relu(self.first(functional.relu(inputs))))
        # Changes add up over a rollout; bfloat16 is not precise enough for the sum.
        with full_precision(s.device):
            attended = self._attended(inputs)
        return self.norm(s + change.float() + attended).unflatten(0, (batch, objects))

    def _attended(self, inputs: Tensor) -> Tensor:
        """Change [B N, C, 8, 8] by the perceptron."""
        places = self.places.expand(inputs.shape[0], -1, -1, -1)
        # Channels of the other balls come last, so that the weights of one ball can be widened.
        logits = self.where(torch.cat([places, inputs], dim=1)).flatten(2)
        read_weights, write_weights = logits.softmax(dim=-1).chunk(2, dim=1)
        read = inputs.flatten(2) @ read_weights.transpose(1, 2)
        answer = self.answer(read.flatten(1)).unflatten(1, (self.points, -1))
        return (GRID * answer.transpose(1, 2) @ write_weights).unflatten(2, (GRID, GRID))


class PerceptionStateNetwork(RecurrentNetwork, PerceptionNetwork):
    """Recurrent network on a state that perception initialises."""

    def begin(self, perceived: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from the outputs of perception."""
        assert isinstance(self.encoder, PerceptionStateEncoder)
        s = self.encoder.begin(initial_state_of(perceived, finals_BN2))
        return State(s, self.motion.start(s))


class PerceptionStateFamily(SharedStateFamily, PerceptionFamily):
    """Predictors on one shared state that perception initialises."""

    @property
    def encoder(self) -> PerceptionStateEncoder:
        """Encoder that all members share."""
        encoder = next(iter(self.predictors().values())).encoder
        assert isinstance(encoder, PerceptionStateEncoder)
        return encoder

    def initial_state(self, frames_BKHW3: Tensor) -> InitialState:
        """Return the initial state that perception finds in the frames."""
        return self.encoder.initial_state(frames_BKHW3)

    def forecast_from(self, initial: InitialState, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return self.roll_out(self.encoder.begin(initial), horizon)


def perception_state_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make a perception-initialised family (see :class:`training.networks.presets.Preset`)."""
    encoder = PerceptionStateEncoder(task, CHANNELS)
    interaction = ObjectInteraction() if task.meetings else None
    transition = AttendedTransition(CHANNELS, interaction)
    spin, kind = task.angular_velocity, PerceptionStateNetwork
    return PerceptionStateFamily(composed(variants, encoder, transition, spin=spin, kind=kind))
