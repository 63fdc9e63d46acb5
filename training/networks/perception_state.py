"""The sighted preset: a convolutional state that begins with what a taught eye reads.

The eye is FieldNet's (``eye.py``). What it reads of the ground and of the balls is spread over the
8 x 8 cells; from there on the state is learned, as in the compact preset, whose heads it shares.
States can be spread from the truth as well, so transition and heads train without any image.
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
from training.networks.perception import Eye, PerceptionNetwork, looked
from training.networks.recurrent import (
    Family,
    InitialState,
    Observation,
    PerceptionFamily,
    PerceptionOutput,
    Predictor,
    SharedStateFamily,
    State,
)
from training.networks.task import Task

FOLD = 4
"""The ground's 32 x 32 cells are folded into the state's 8 x 8: so many a side go into one."""


class Spread(nn.Module):
    """What is known of ground and balls, over the cells of s_0 [B, N, C, 8, 8].

    Every cell knows its own ground, every ball's numbers, and where the ball is from there.
    """

    places: Tensor

    def __init__(self, channels: int, *, final: bool) -> None:
        super().__init__()
        self.register_buffer("places", cell_centres(), persistent=False)
        points = 2 if final else 1
        known = 3 * FOLD**2 + 2 + 2 + 2 * 7 + points * (2 + 1)
        self.layers = nn.Sequential(
            nn.Conv2d(known, channels, 1), nn.ReLU(), nn.Conv2d(channels, channels, 1)
        )
        self.norm = ChannelNorm()

    def forward(self, sight: InitialState) -> Tensor:
        """s_0 of a sight."""
        ball = Ball.unpacked(sight.state.p)
        numbers = torch.cat([ball.centre[..., 2:], 10 * ball.velocity, ball.spin], dim=-1)
        everywhere = torch.cat([numbers, ball.measures], dim=-1)[..., None, None]
        batch, objects = everywhere.shape[:2]
        ground = functional.pixel_unshuffle(sight.state.s, FOLD)[:, None]
        here = self._from_cells(ball.centre[..., :2])
        known = [
            ground.expand(-1, objects, -1, -1, -1),
            everywhere.expand(-1, -1, -1, GRID, GRID),
            self.places.expand(batch, objects, -1, -1, -1),
            here,
            here[:, :, 2:] * numbers[..., None, None],
            *([] if sight.finals is None else [self._from_cells(sight.finals)]),
        ]
        cells = torch.cat(known, dim=2).flatten(0, 1)
        return self.norm(self.layers(cells)).unflatten(0, (batch, objects))

    def _from_cells(self, points_BN2: Tensor) -> Tensor:
        """Way from every cell to a point, in cells, and how near it is [B, N, 3, 8, 8]."""
        way = (points_BN2[..., None, None] - self.places) * (GRID / 2)
        near = (-0.5 * way.square().sum(dim=2, keepdim=True)).exp()
        return torch.cat([way, near], dim=2)


class SightedEncoder(nn.Module):
    """Frames to s_0 through an eye that has been taught what to read."""

    def __init__(self, task: Task, channels: int) -> None:
        super().__init__()
        self.eye = Eye(task.objects)
        self.spread = Spread(channels, final=task.final_step is not None)

    def forward(self, frames_BKHW3: Tensor) -> Tensor:
        """Frames uint8 to s_0."""
        return self.begin(self.look(frames_BKHW3))

    def look(self, frames_BKHW3: Tensor) -> InitialState:
        """Return what the eye reads."""
        return sight_of(*looked(self.eye, frames_BKHW3))

    def begin(self, sight: InitialState) -> Tensor:
        """s_0 of what was read, or of the truth."""
        with full_precision(sight.state.p.device):
            return self.spread(sight)


def sight_of(reading: PerceptionOutput, finals_BN2: Tensor | None) -> InitialState:
    """Return what a forecast begins with, from what an eye read; nothing is doubted yet."""
    return InitialState(seen_state(reading, torch.zeros_like(reading.centres)), finals_BN2)


class AttendedTransition(nn.Module):
    """s_{t+1} = phi_s(s_t): convolutions, and a perceptron that reads and writes where it attends.

    Convolutions carry what is local; how a ball moves depends on few numbers of few cells, which
    the perceptron gathers by a softmax over the cells, and adds its answer where a second one says.

    Parameters
    ----------
    interaction
        What lets the balls know of each other; None moves each alone.
    """

    places: Tensor
    points = 4
    """Places at which a state is read and written."""

    def __init__(self, channels: int, interaction: ObjectInteraction | None = None) -> None:
        super().__init__()
        narrow, wide = 64, 256
        self.interaction = interaction
        self.register_buffer("places", cell_centres()[None], persistent=False)
        seen = channels if interaction is None else 2 * channels
        self.first = nn.Conv2d(seen, narrow, 3, padding=1)
        self.second = nn.Conv2d(narrow, channels, 3, padding=1)
        self.where = nn.Sequential(
            nn.Conv2d(seen + 2, narrow, 1), nn.ReLU(), nn.Conv2d(narrow, 2 * self.points, 1)
        )
        self.answer = nn.Sequential(
            nn.Linear(self.points * seen, wide), nn.SiLU(),
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
        seen = s if self.interaction is None else self.interaction(s_BNCHW).flatten(0, 1)
        change = self.second(functional.relu(self.first(functional.relu(seen))))
        # What is added up over a rollout needs more digits than bfloat16 has.
        with full_precision(s.device):
            attended = self._attended(seen)
        return self.norm(s + change.float() + attended).unflatten(0, (batch, objects))

    def _attended(self, seen: Tensor) -> Tensor:
        """Change [B N, C, 8, 8] that the perceptron makes."""
        places = self.places.expand(seen.shape[0], -1, -1, -1)
        # What there is of other balls comes last: a ball's weights serve several, widened.
        logits = self.where(torch.cat([places, seen], dim=1)).flatten(2)
        reading, writing = logits.softmax(dim=-1).chunk(2, dim=1)
        read = seen.flatten(2) @ reading.transpose(1, 2)
        answer = self.answer(read.flatten(1)).unflatten(1, (self.points, -1))
        return (GRID * answer.transpose(1, 2) @ writing).unflatten(2, (GRID, GRID))


class SightedPredictor(Predictor, PerceptionNetwork):
    """A predictor over a sighted state."""

    def begin(self, reading: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from what the eye read."""
        assert isinstance(self.encoder, SightedEncoder)
        s = self.encoder.begin(sight_of(reading, finals_BN2))
        return State(s, self.motion.start(s))


class SightedFamily(SharedStateFamily, PerceptionFamily):
    """Predictors over one sighted state."""

    @property
    def encoder(self) -> SightedEncoder:
        """What all members share."""
        encoder = next(iter(self.predictors().values())).encoder
        assert isinstance(encoder, SightedEncoder)
        return encoder

    def sight(self, frames_BKHW3: Tensor) -> InitialState:
        """Return what the eye reads of the frames."""
        return self.encoder.look(frames_BKHW3)

    def forecast_from(self, sight: InitialState, horizon: int) -> dict[str, Observation]:
        """Observations of the steps 0..horizon-1 of every member."""
        return self.roll_out(self.encoder.begin(sight), horizon)


def sighted_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make a family in the sighted preset (see :class:`training.networks.presets.Preset`)."""
    encoder = SightedEncoder(task, CHANNELS)
    met = ObjectInteraction() if task.meetings else None
    transition = AttendedTransition(CHANNELS, met)
    spin = task.angular_velocity
    return SightedFamily(composed(variants, encoder, transition, spin=spin, kind=SightedPredictor))
