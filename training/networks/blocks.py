"""Building blocks of the networks (paper, section 3; decision 0012).

Shape suffixes: B batch, N objects, T steps, C channels, H and W grid, K seen frames, P motion
state.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from rollcast.camera import NETWORK_FRAME_SIZE

GRID = 8
"""Cells a side of the distributed state s_t."""

PIXEL_UNIT = NETWORK_FRAME_SIZE / 2
"""Networks count positions in halves of the frame from its centre."""


def normalised_frames(frames_BKHW3: Tensor) -> Tensor:
    """Turn uint8 frames into one image of 3 K channels: the last frame and the changes before it.

    The change channels are zero wherever nothing moves, so balls stand out from any background.
    """
    images = frames_BKHW3.permute(0, 1, 4, 2, 3).float() / 255
    last = images[:, 3:4] - 0.5
    changes = 2 * (images[:, 1:4] - images[:, 0:3])
    final = images[:, 4:] - 0.5
    return torch.cat([last, changes, final], dim=1).flatten(1, 2)


def cell_centres(cells: int = GRID) -> Tensor:
    """Image points (x, y) [2, cells, cells] of a grid's cells, halves of the frame."""
    along = (torch.arange(cells) + 0.5) * (2 / cells) - 1
    y, x = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([x, y])


class ResidualConv(nn.Module):
    """x + conv(relu(conv(relu(x)))), initialised as the identity."""

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, hidden, 3, padding=1)
        self.second = nn.Conv2d(hidden, channels, 3, padding=1)
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Image to image of the same shape."""
        return x + self.second(functional.relu(self.first(functional.relu(x))))


class ChannelNorm(nn.Module):
    """Scales the channels of every cell to unit mean square, which keeps a rollout bounded."""

    def forward(self, x: Tensor) -> Tensor:
        """Image to image of the same shape."""
        return x * torch.rsqrt(x.float().square().mean(dim=1, keepdim=True) + 1e-6).to(x.dtype)


class CompactEncoder(nn.Module):
    """Frames to the distributed state s_0 [B, N, C, 8, 8]: a stride-4 stem and residual stages."""

    def __init__(self, frames: int, objects: int, channels: int) -> None:
        super().__init__()
        self.objects = objects
        self.layers = nn.Sequential(
            nn.Conv2d(3 * frames, 64, 8, stride=4, padding=2),
            ResidualConv(64, 64),
            nn.ReLU(),
            nn.Conv2d(64, 128, 3, stride=2, padding=1),
            ResidualConv(128, 128),
            nn.ReLU(),
            nn.Conv2d(128, 128, 3, stride=2, padding=1),
            ResidualConv(128, 96),
            ResidualConv(128, 96),
            nn.ReLU(),
            nn.Conv2d(128, objects * channels, 1),
        )
        self.norm = ChannelNorm()

    def forward(self, frames_BKHW3: Tensor) -> Tensor:
        """Frames uint8 to s_0."""
        image = normalised_frames(frames_BKHW3).contiguous(memory_format=torch.channels_last)
        s = self.layers(image)
        s_BNCHW = s.unflatten(1, (self.objects, -1))
        return self.norm(s_BNCHW.flatten(0, 1)).unflatten(0, (-1, self.objects))


class ObjectInteraction(nn.Module):
    """Appends to every ball's state the sum of the other balls' (paper, section 3.5)."""

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """States [B, N, C, 8, 8] to [B, N, 2 C, 8, 8]."""
        others = s_BNCHW.sum(dim=1, keepdim=True) - s_BNCHW
        return torch.cat([s_BNCHW, others], dim=2)


class ConvTransition(nn.Module):
    """s_{t+1} = phi_s(s_t): two 3 x 3 convolutions (paper, section 3.2) around a skip.

    Parameters
    ----------
    interaction
        Interaction between balls; None moves every ball independently.
    """

    def __init__(
        self, channels: int, hidden: int, interaction: ObjectInteraction | None = None
    ) -> None:
        super().__init__()
        self.interaction = interaction
        seen = channels if interaction is None else 2 * channels
        self.first = nn.Conv2d(seen, hidden, 3, padding=1)
        self.second = nn.Conv2d(hidden, channels, 3, padding=1)
        nn.init.normal_(self.second.weight, std=1e-3)
        self.norm = ChannelNorm()

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """s_t to s_{t+1}."""
        batch = s_BNCHW.shape[0]
        seen = s_BNCHW if self.interaction is None else self.interaction(s_BNCHW)
        change = self.second(functional.relu(self.first(seen.flatten(0, 1))))
        moved = self.norm(s_BNCHW.flatten(0, 1) + change)
        return moved.unflatten(0, (batch, -1))


class SpatialReadout(nn.Module):
    """Reads numbers from the state: every cell proposes values, a softmax over cells weighs them.

    With ``hidden`` there are two layers, without one (the paper's phi_p of PosNet and of DispNet).
    The grid's coordinates are appended first, as in the paper's aug_xy. With ``relative`` the first
    two outputs are offsets from the proposing cell's centre.
    """

    coordinates: Tensor
    shift: Tensor

    def __init__(
        self, channels: int, outputs: int, hidden: int | None = None, *, relative: bool = False
    ) -> None:
        super().__init__()
        width = channels + 2
        self.hidden = nn.Conv2d(width, hidden, 1) if hidden else None
        self.proposals = nn.Conv2d(hidden or width, outputs + 1, 1)
        nn.init.normal_(self.proposals.weight, std=1e-2)
        coordinates = cell_centres()
        self.register_buffer("coordinates", coordinates[None], persistent=False)
        shift = torch.zeros(1, outputs, GRID, GRID)
        if relative:
            shift[:, :2] = coordinates
        self.register_buffer("shift", shift, persistent=False)

    def forward(self, s_BNCHW: Tensor) -> Tensor:
        """Read the outputs [B, N, P] from s_t."""
        batch = s_BNCHW.shape[0]
        s = s_BNCHW.flatten(0, 1)
        s = torch.cat([s, self.coordinates.to(s.dtype).expand(s.shape[0], -1, -1, -1)], dim=1)
        if self.hidden is not None:
            s = functional.relu(self.hidden(s))
        # Sub-pixel answers need more digits than bfloat16 has.
        proposed = self.proposals(s).float()
        weights = proposed[:, :1].flatten(2).softmax(dim=-1)
        values = (proposed[:, 1:] + self.shift).flatten(2)
        return (weights * values).sum(dim=-1).unflatten(0, (batch, -1))
