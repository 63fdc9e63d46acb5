"""V-LSTM: AlexNet sees, an LSTM forgets nothing (after Fragkiadaki et al., 2016; section 5.1).

AlexNet's first four convolutions read the four frames at once; a dense layer turns their output
into the initial state of an LSTM. Its later inputs are its own last outputs, without images, and
its decoder predicts the next state only. With several balls every ball has its own network. Details
from the code of the reference: two layers of 512 units, a decoder of two layers of
256, positions relative to the frame's centre.
"""

from pathlib import Path

import torch
from torch import Tensor, nn

from training.baselines.interaction import perceptron
from training.baselines.learner import Learner, LearnerForecast
from training.baselines.states import HALF_FRAME_PX
from training.data.windows import Batch
from training.networks.imagenet import read_convolutions
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT

UNITS, LAYERS, DECODER = 512, 2, 256
SIGHT = 256 * 7 * 7
"""Numbers that AlexNet makes of 128 x 128 pixels there."""
FRAMES = 4


class AlexNetEncoder(nn.Module):
    """AlexNet to its fourth convolution, on four frames stacked."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3 * FRAMES, 64, 11, stride=4, padding=2),
            nn.ReLU(),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(64, 192, 5, padding=2),
            nn.ReLU(),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(192, 384, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(384, 256, 3, padding=1),
            nn.ReLU(),
        )
        for layer in self.features:
            if isinstance(layer, nn.Conv2d):
                # The paper's initialisation of layers without ImageNet weights. With torch's
                # smaller defaults, the output ignores the frames (docs/experiments.md).
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")

    def forward(self, frames_BKHW3: Tensor) -> Tensor:
        """Return the features [B, SIGHT] of uint8 frames."""
        stacked = frames_BKHW3.permute(0, 1, 4, 2, 3).flatten(1, 2)
        return self.features(stacked.float() / 255 - 0.5).flatten(1)

    def load_imagenet(self, path: Path) -> int:
        """Copy ImageNet's AlexNet into all convolutions but the first; return how many.

        Parameters
        ----------
        path
            As :func:`training.networks.imagenet.read_convolutions` reads it.

        Raises
        ------
        ValueError
            When the file lacks one of them.
        """
        stored = read_convolutions(path)
        own = [layer for layer in self.features if isinstance(layer, nn.Conv2d)]
        for index, convolution in enumerate(own[1:], 1):
            if index not in stored:
                raise ValueError(f"{path} lacks convolution {index + 1} of AlexNet")
            weight, bias = stored[index]
            convolution.load_state_dict({"weight": weight, "bias": bias})
        return len(own) - 1


class OneBall(nn.Module):
    """The network of one ball."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.encoder = AlexNetEncoder()
        self.begin = nn.Sequential(nn.Linear(SIGHT, UNITS), nn.ReLU())
        self.memory = nn.ModuleList(nn.LSTMCell(UNITS, UNITS) for _ in range(LAYERS))
        self.decoder = perceptron((UNITS, DECODER, outputs))

    def forward(self, frames_BKHW3: Tensor, horizon: int) -> Tensor:
        """States [B, T, 2 or 5] from t = 0 on."""
        given = self.begin(self.encoder(frames_BKHW3))
        held: list[tuple[Tensor, Tensor] | None] = [None] * LAYERS
        outputs: list[Tensor] = []
        for _ in range(horizon):
            for layer, cell in enumerate(self.memory):
                held[layer] = state = cell(given, held[layer])
                given = state[0]
            outputs.append(self.decoder(given))
        return torch.stack(outputs, dim=1)


class VLstm(Learner[Batch]):
    """A network for every ball.

    Parameters
    ----------
    horizon
        T_train.
    imagenet
        AlexNet of ImageNet (``training.networks.imagenet``); without it the encoders start from
        random weights.
    """

    def __init__(
        self, objects: int, horizon: int, *, angular_velocity: bool, imagenet: Path | None = None
    ) -> None:
        super().__init__()
        self.sees_spin = angular_velocity
        self._horizon = horizon
        self.balls = nn.ModuleList(OneBall(5 if angular_velocity else 2) for _ in range(objects))
        if imagenet is not None:
            for ball in self.balls:
                assert isinstance(ball, OneBall)
                ball.encoder.load_imagenet(imagenet)

    def loss(self, given: Batch, progress: float) -> Tensor:  # noqa: ARG002 - the same all the time
        """Squared errors of positions and angular velocities, as of the paper's own networks."""
        parts = [given["positions"] / HALF_FRAME_PX - 1]
        if self.sees_spin:
            parts.append(given["angular_velocities"] / ANGULAR_VELOCITY_UNIT)
        truth = torch.cat([part[:, :, : self._horizon] for part in parts], dim=-1)
        return (self._states(given["frames"], self._horizon) - truth).square().sum(-1).mean()

    def forecast(self, given: Batch, horizon: int) -> LearnerForecast:
        """Let every ball's memory tell its states."""
        states = self._states(given["frames"], horizon)
        return LearnerForecast.of(states[..., :2], states[..., 2:] if self.sees_spin else None)

    def _states(self, frames_BKHW3: Tensor, horizon: int) -> Tensor:
        return torch.stack([ball(frames_BKHW3, horizon) for ball in self.balls], dim=1)
