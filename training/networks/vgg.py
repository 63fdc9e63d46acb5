"""The paper's own networks: VGG16 to conv5 and perceptron read-outs (paper, section 5.2).

Choices that the paper leaves open: He's Gaussian initialises convolutions, positions are in halves
of the frame, PosNet's first perceptron layer has 256 units.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.networks.blocks import GRID, PIXEL_UNIT, ObjectInteraction
from training.networks.imagenet import read_convolutions
from training.networks.recurrent import (
    ANGULAR_VELOCITY_UNIT,
    DirectMotion,
    Family,
    GaussianOutput,
    Head,
    IncrementalMotion,
    PointOutput,
    RecurrentNetwork,
    SharedStateFamily,
)
from training.networks.task import Task

VGG16 = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Output channels of the convolutions between two poolings."""
ALONE_CHANNELS, SHARED_CHANNELS = 512, 256
"""Channels of the state of one ball, and of each of several."""
HIDDEN = 256

POINT = (PIXEL_UNIT,) * 2
GAUSSIAN = (*POINT, 1.0, 1.0, 1.0)
SPIN = (ANGULAR_VELOCITY_UNIT,) * 3
"""Units of the outputs, in pixels and rad/s."""

Layer = TypeVar("Layer", nn.Conv2d, nn.Linear)


class VggEncoder(nn.Module):
    """VGG16's convolutions on the stack of all frames, 3 K channels, down to 8 x 8.

    With several balls the last convolution is made anew, with 256 channels a ball.
    """

    def __init__(self, frames: int, objects: int, channels: int) -> None:
        super().__init__()
        self.objects = objects
        blocks = [list(widths) for widths in VGG16]
        blocks[-1][-1] = objects * channels
        self.blocks = nn.ModuleList()
        inputs = 3 * frames
        for widths in blocks:
            block = nn.ModuleList()
            for width in widths:
                block.append(_gaussian(nn.Conv2d(inputs, width, 3, padding=1)))
                inputs = width
            self.blocks.append(block)

    def forward(self, frames_BKHW3: Tensor) -> Tensor:
        """Frames uint8 to s_0 [B, N, C, 8, 8]."""
        x = frames_BKHW3.permute(0, 1, 4, 2, 3).flatten(1, 2).float() - 127.5
        for index, block in enumerate(self.blocks):
            assert isinstance(block, nn.ModuleList)
            if index > 0:
                x = functional.max_pool2d(x, 2)
            for convolution in block:
                x = functional.relu(convolution(x))
        return x.unflatten(1, (self.objects, -1))


class PlainTransition(nn.Module):
    """s_{t+1} = phi_s(s_t): 3 x 3 x 256, ReLU, 3 x 3 x C."""

    def __init__(self, channels: int, interaction: ObjectInteraction | None) -> None:
        super().__init__()
        self.interaction = interaction
        seen = channels if interaction is None else 2 * channels
        self.first = _gaussian(nn.Conv2d(seen, 256, 3, padding=1))
        # No rectifier follows: He's Gaussian would double the state's power every step.
        self.second = _gaussian(nn.Conv2d(256, channels, 3, padding=1), "linear")

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """s_t to s_{t+1}."""
        seen = s_BNCHW if self.interaction is None else self.interaction(s_BNCHW)
        moved = self.second(functional.relu(self.first(seen.flatten(0, 1))))
        return moved.unflatten(0, s_BNCHW.shape[:2])


class Perceptron(nn.Module):
    """Dense read-out of the whole state: one layer, or two over aug_xy(s_t).

    Its last layer outputs pixels and rad/s, independent of the units outside: with larger units,
    sums of 32,768 numbers change too much with every step of RMSProp.

    Parameters
    ----------
    units
        Of every output, in pixels or rad/s.
    """

    coordinates: Tensor
    units: Tensor

    def __init__(
        self, channels: int, units: tuple[float, ...], *, two_layers: bool = False
    ) -> None:
        super().__init__()
        centres = (torch.arange(GRID) + 0.5) * (2 / GRID) - 1
        y, x = torch.meshgrid(centres, centres, indexing="ij")
        self.register_buffer("coordinates", torch.stack([x, y]), persistent=False)
        self.register_buffer("units", torch.tensor(units), persistent=False)
        width = (channels + 2 * two_layers) * GRID * GRID
        self.hidden = _gaussian(nn.Linear(width, HIDDEN)) if two_layers else None
        self.last = _gaussian(nn.Linear(HIDDEN if two_layers else width, len(units)), "linear")

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """Read the outputs [B, N, P] from s_t."""
        if self.hidden is None:
            return self.last(s_BNCHW.flatten(2)).float() / self.units
        place = self.coordinates.to(s_BNCHW.dtype).expand(*s_BNCHW.shape[:2], -1, -1, -1)
        seen = torch.cat([s_BNCHW, place], dim=2).flatten(2)
        return self.last(functional.relu(self.hidden(seen))).float() / self.units


def _posnet(channels: int) -> Head:
    return Head(DirectMotion(Perceptron(channels, POINT, two_layers=True)), PointOutput())


def _dispnet(channels: int) -> Head:
    return Head(
        IncrementalMotion(Perceptron(channels, POINT), Perceptron(channels, POINT)), PointOutput()
    )


def _probnet(channels: int) -> Head:
    motion = IncrementalMotion(Perceptron(channels, GAUSSIAN), Perceptron(channels, GAUSSIAN))
    return Head(motion, GaussianOutput())


def _interpnet(channels: int) -> Head:
    return _dispnet(channels)._replace(final=Perceptron(channels, POINT))


HEADS: Mapping[str, Callable[[int], Head]] = {
    "posnet": _posnet,
    "dispnet": _dispnet,
    "probnet": _probnet,
    "interpnet": _interpnet,
}


def paper_family(variants: Mapping[str, str], task: Task) -> Family:
    """Make a family in the paper's preset (see :class:`training.networks.presets.Preset`)."""
    channels = ALONE_CHANNELS if task.objects == 1 else SHARED_CHANNELS
    encoder = VggEncoder(task.frames, task.objects, channels)
    met = ObjectInteraction() if task.meetings else None
    transition = PlainTransition(channels, met)
    spin = Perceptron(channels, SPIN) if task.angular_velocity else None
    return SharedStateFamily(
        {
            name: RecurrentNetwork(encoder, transition, HEADS[variant](channels), spin)
            for name, variant in variants.items()
        }
    )


def load_imagenet(encoder: VggEncoder, path: Path) -> int:
    """Copy ImageNet's VGG16 into every convolution but the first; return how many were copied.

    Parameters
    ----------
    path
        As :func:`training.networks.imagenet.read_convolutions` reads it.

    Raises
    ------
    ValueError
        When the file lacks a convolution of VGG16.
    """
    stored = read_convolutions(path)
    copied = 0
    own = [convolution for block in encoder.blocks for convolution in block.children()]
    for index, convolution in enumerate(own):
        assert isinstance(convolution, nn.Conv2d)
        if index not in stored:
            raise ValueError(f"{path} lacks convolution {index + 1} of VGG16")
        weight, bias = stored[index]
        # conv1 sees more channels; with several balls conv5's last layer is made anew.
        if index > 0 and weight.shape == convolution.weight.shape:
            with torch.no_grad():
                convolution.weight.copy_(weight)
                convolution.bias.copy_(bias)  # pyright: ignore[reportOptionalMemberAccess]
            copied += 1
    return copied


def _gaussian(layer: Layer, follows: Literal["relu", "linear"] = "relu") -> Layer:
    """Draw a layer's weights from the Gaussian that preserves the signal's power (He et al.)."""
    nn.init.kaiming_normal_(layer.weight, nonlinearity=follows)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer
