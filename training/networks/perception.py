"""The eye of the explicit-state network: frames to the ground and to every ball's state.

A first look at the whole frames maps the ground and says roughly where the balls are; closer looks
at patches around them, all seen frames side by side, give positions to fractions of a pixel and
show how the texture turns. An eye with a zoomed look measures each ball's radius as well and looks
once more, at a patch that the ball just fills.

Lengths are halves of the frame in image axes (x right, y down, z towards the camera), times are
frames. Shape suffixes as in ``blocks.py``.
"""

from abc import abstractmethod

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from rollcast.camera import BOWL_HALF_WIDTH_M, NETWORK_FRAME_SIZE
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES
from training.common.precision import full_precision
from training.networks.blocks import PIXEL_UNIT, ResidualConv, cell_centres, normalised_frames
from training.networks.recurrent import ANGULAR_VELOCITY_UNIT, Network, PerceptionOutput, State

FEATURES = 128
"""Numbers that the closest look says of every ball besides its positions."""

PATCH = 32
"""Samples a side of a closer look."""

PATCH_HALF_WIDTH = 20 / PIXEL_UNIT
"""40 pixels: the largest ball of any scenario, and some ground around it."""

ZOOM_MARGIN = 4 / PIXEL_UNIT
"""Ground around the ball in a zoomed look: 4 pixels, of which motion blur may take some."""

USUAL_RADIUS, SMALLEST_SEEN, LARGEST_SEEN = 8 / PIXEL_UNIT, 1 / PIXEL_UNIT, 40 / PIXEL_UNIT
"""Radius that an untaught zoomed look assumes, and the limits of what it can say."""

STEEPEST = 0.3
"""Least upright part of a normal that is divided by."""

SMALLEST_RADIUS = 0.02
"""Halves of the frame; an untaught eye may see anything."""

SAMPLE_AHEAD = (0.0, 0.5, 1.0)
"""Frames ahead at which the ground is felt for the first velocity."""


def of_each(module: nn.Module, x: Tensor) -> Tensor:
    """Apply a perceptron over the last axis.

    Written as one matrix product: only those keep their parameters' names in an exported graph.
    """
    return module(x.flatten(0, -2)).unflatten(0, x.shape[:-1])


def measures_of(half_width_m: float, radius_m: float) -> Float[np.ndarray, "2"]:
    """Constants of a scene, of a size that networks read easily; zero for a bowl's frame."""
    return np.array([5 * (half_width_m - BOWL_HALF_WIDTH_M), 5 * radius_m])


def radius_of(measures: Tensor) -> Tensor:
    """Ball radius [..., 1] in halves of the frame, from what :func:`measures_of` made."""
    scale, radius = measures.split(1, dim=-1)
    return (radius / 5) / (BOWL_HALF_WIDTH_M + scale / 5)


def rise_along(lean: Tensor, flat_velocity: Tensor) -> Tensor:
    """Rise [..., 1] that keeps a ball on its ground: no velocity along the normal."""
    upright = (1 - lean.square().sum(dim=-1, keepdim=True)).clamp(min=STEEPEST**2).sqrt()
    return -(lean * flat_velocity).sum(dim=-1, keepdim=True) / upright


def rolling_spin(lean: Tensor, velocity: Tensor, radius: Tensor) -> Tensor:
    """Spin [..., 3] of a ball that rolls without slipping: omega = n x v / r.

    Parameters
    ----------
    lean
        Image x and y of the ground's unit normal [..., 2].
    velocity
        [..., 3] a frame, image axes.
    radius
        [..., 1].

    Returns
    -------
    Units of 20 rad/s, world axes: world y is image -y.
    """
    upright = (1 - lean.square().sum(dim=-1)).clamp(min=0).sqrt()
    (nx, ny), (vx, vy, vz) = lean.unbind(-1), velocity.unbind(-1)
    turned = torch.stack(
        [-ny * vz + upright * vy, upright * vx - nx * vz, -nx * vy + ny * vx], dim=-1
    )
    return turned * (FRAME_RATE_HZ / ANGULAR_VELOCITY_UNIT) / radius.clamp(min=SMALLEST_RADIUS)


def sampled(ground_B3GG: Tensor, points_BMA2: Tensor) -> Tensor:
    """Ground [B, M, A, 3] at image points, bilinear; beyond the frame its border goes on."""
    values = functional.grid_sample(
        ground_B3GG, points_BMA2, padding_mode="border", align_corners=False
    )
    return values.permute(0, 2, 3, 1)


class FirstLook(nn.Module):
    """Whole frames to ground, measures and rough positions: down to 8 x 8 cells and up again.

    Every pixel also tells its place: a bowl's ground is a function of little else.
    """

    place: Tensor

    def __init__(self, objects: int) -> None:
        super().__init__()
        fine, middle, coarse = 48, 96, 128
        self.seen = (objects, OBSERVED_FRAMES)
        self.register_buffer("place", cell_centres(NETWORK_FRAME_SIZE)[None], persistent=False)
        self.stem = nn.Sequential(
            nn.Conv2d(3 * OBSERVED_FRAMES + 2, fine, 8, stride=4, padding=2),
            ResidualConv(fine, fine),
        )
        self.down_16 = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(fine, middle, 3, stride=2, padding=1),
            ResidualConv(middle, middle),
        )
        self.down_8 = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(middle, coarse, 3, stride=2, padding=1),
            ResidualConv(coarse, middle),
            ResidualConv(coarse, middle),
        )
        self.up_16 = nn.Conv2d(coarse, middle, 1)
        self.refine_16 = ResidualConv(middle, middle)
        self.up_32 = nn.Conv2d(middle, fine, 1)
        self.refine_32 = ResidualConv(fine, fine)
        self.ground = nn.Conv2d(fine, 3, 3, padding=1)
        self.where = nn.Conv2d(middle, objects * OBSERVED_FRAMES * 3, 1)
        self.measures = nn.Linear(coarse, 2)

    def forward(self, frames_BKHW3: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Positions [B, N, K, 2] in the seen frames, ground [B, 3, 32, 32] and measures [B, 2]."""
        ground, measures, _, at_16 = self.trunk(frames_BKHW3)
        return _attended(self.where(at_16), self.seen), ground, measures

    def trunk(self, frames_BKHW3: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Ground, measures, and the rectified features at 32 x 32 and at 16 x 16 cells."""
        image = normalised_frames(frames_BKHW3)
        image = torch.cat([image, self.place.expand(image.shape[0], -1, -1, -1)], dim=1)
        image = image.contiguous(memory_format=torch.channels_last)
        at_32 = self.stem(image)
        at_16 = self.down_16(at_32)
        at_8 = self.down_8(at_16)
        at_16 = self.refine_16(at_16 + functional.interpolate(self.up_16(at_8), scale_factor=2.0))
        at_32 = self.refine_32(at_32 + functional.interpolate(self.up_32(at_16), scale_factor=2.0))
        ground = self.ground(at_32.relu()).float()
        ground = torch.cat([ground[:, :2].tanh(), ground[:, 2:]], dim=1)
        measures = self.measures(at_8.relu().float().mean(dim=(2, 3))).float()
        return ground, measures, at_32.relu(), at_16.relu()


def patch_layers(size: int) -> nn.Sequential:
    """Return the layers that read the patches of a ball, ``size`` samples wide, to [256]."""
    return nn.Sequential(
        nn.Conv2d(3 * OBSERVED_FRAMES, 64, 5, stride=2, padding=2),
        ResidualConv(64, 64),
        ResidualConv(64, 64),
        nn.ReLU(),
        nn.Conv2d(64, 96, 3, stride=2, padding=1),
        ResidualConv(96, 96),
        ResidualConv(96, 96),
        nn.ReLU(),
        nn.Conv2d(96, 24, 1),
        nn.Flatten(),
        nn.Linear(24 * (size // 4) ** 2, 256),
        nn.ReLU(),
    )


class CloserLook(nn.Module):
    """Patches around the balls, all frames of one ball side by side, to corrections of positions.

    Parameters
    ----------
    features
        Numbers that say what else the patches show: how the ball turns, where it is hidden. There
        may be none.
    """

    grid: Tensor

    def __init__(self, features: int) -> None:
        super().__init__()
        self.layers = patch_layers(PATCH)
        self.correction = nn.Linear(256, 2 * OBSERVED_FRAMES)
        self.features = nn.Linear(256, features) if features else None
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)
        grid = PATCH_HALF_WIDTH * cell_centres(PATCH).permute(1, 2, 0)
        self.register_buffer("grid", grid, persistent=False)

    def forward(
        self, images_BK3HW: Tensor, around_BNK2: Tensor, zoom_BN: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Corrected positions [B, N, K, 2] and features [B, N, features].

        Parameters
        ----------
        zoom_BN
            Half-width of every ball's patch relative to the usual one; corrections scale with it.
        """
        batch, objects, frames = around_BNK2.shape[:3]
        # The correction is what learns, not the way to a better patch.
        centres = around_BNK2.detach()
        grid = self.grid
        if zoom_BN is not None:
            zooms = zoom_BN[:, None].expand(-1, frames, -1).flatten(0, 1)
            grid = zooms[..., None, None, None] * grid
        grid = grid + centres.transpose(1, 2).flatten(0, 1)[:, :, None, None]
        # Balls lie below one another: one sampling a frame serves all of them.
        patches = functional.grid_sample(
            images_BK3HW.flatten(0, 1), grid.flatten(1, 2),
            padding_mode="border", align_corners=False,
        )  # fmt: skip
        patches = patches.reshape(batch, frames, 3, objects, PATCH, PATCH)
        stacked = patches.permute(0, 3, 1, 2, 4, 5).reshape(-1, 3 * frames, PATCH, PATCH)
        seen = self.layers(stacked.contiguous(memory_format=torch.channels_last))
        correction = self.correction(seen).float().reshape(batch, objects, frames, 2)
        if zoom_BN is not None:
            correction = correction * zoom_BN[..., None, None]
        corrected = centres + correction
        if self.features is None:
            return corrected, correction.new_zeros(batch, objects, 0)
        return corrected, self.features(seen).float().reshape(batch, objects, -1)


class ZoomedLook(nn.Module):
    """A last look at a patch that the ball just fills, whatever its size."""

    def __init__(self) -> None:
        super().__init__()
        self.size = nn.Linear(FEATURES, 1)
        nn.init.zeros_(self.size.weight)
        nn.init.zeros_(self.size.bias)
        self.look = CloserLook(0)

    def forward(
        self, images_BK3HW: Tensor, around_BNK2: Tensor, features_BNF: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Corrected positions [B, N, K, 2] and radii [B, N], halves of the frame."""
        radii = USUAL_RADIUS * of_each(self.size, features_BNF)[..., 0].exp()
        radii = radii.clamp(SMALLEST_SEEN, LARGEST_SEEN)
        zoom = (radii.detach() + ZOOM_MARGIN) / PATCH_HALF_WIDTH
        positions, _ = self.look(images_BK3HW, around_BNK2, zoom)
        return positions, radii


class Eye(nn.Module):
    """First look, two closer looks, and the state at t = 0 from what they found.

    The closer look is the same network twice: the second time its patches are centred already.
    Rise and spin are read as what differs from rolling along the ground without slipping.

    Parameters
    ----------
    zoomed
        The last look, where there is one.
    """

    def __init__(self, objects: int, zoomed: ZoomedLook | None = None) -> None:
        super().__init__()
        self.first = FirstLook(objects)
        self.closer = CloserLook(FEATURES)
        seen = FEATURES + 2 * (OBSERVED_FRAMES - 1) + 2 + 3 * len(SAMPLE_AHEAD) + 2 + 4
        self.state = nn.Sequential(
            nn.Linear(seen, 192), nn.SiLU(), nn.Linear(192, 192), nn.SiLU(), nn.Linear(192, 9)
        )
        self.zoomed = zoomed

    def forward(self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None) -> PerceptionOutput:
        """Look at the observed frames uint8 [B, 4, 128, 128, 3].

        Parameters
        ----------
        prompts_BN2
            Rough places, in the last frame, of the balls that are meant, halves of the frame; NaN
            where the first look finds the ball by itself.
        """
        looks, features, ground, measures, radii = self._look(frames_BKHW3, prompts_BN2)
        exact = looks[-1]
        with full_precision(exact.device):
            last = exact[:, :, -1]
            shifts = exact[:, :, 1:] - exact[:, :, :-1]
            ahead = torch.stack([last + a * shifts[:, :, -1] for a in SAMPLE_AHEAD], dim=2)
            felt = sampled(ground, ahead.detach())
            lean, scale = felt[:, :, 0, :2], measures[:, None].expand(-1, last.shape[1], -1)
            rise = rise_along(lean, shifts[:, :, -1])
            moving = torch.cat([shifts[:, :, -1], rise], dim=-1)
            rolling = rolling_spin(lean, moving, radius_of(scale))
            known = [features, 10 * shifts.flatten(2), last, felt.flatten(2), scale, 10 * rise]
            said = of_each(self.state, torch.cat([*known, rolling], dim=-1))
            height = felt[:, :, 0, 2:] + 0.1 * said[..., 2:3]
            centres = torch.cat([last + 0.01 * said[..., :2], height], dim=-1)
            flat = 0.03 * said[..., 3:5]
            velocities = moving + torch.cat([flat, 0.1 * said[..., 5:6]], dim=-1)
            spins = rolling + said[..., 6:]
        return PerceptionOutput(
            looks, ground, measures, centres, velocities, spins, features, radii
        )

    def at_rest(self, frame_BHW3: Tensor) -> Tensor:
        """Positions [B, N, 2] in a single frame, seen as four of balls that stay put.

        Nothing is learned for it: balls that come to rest are in every training.
        """
        looks, *_ = self._look(frame_BHW3[:, None].expand(-1, OBSERVED_FRAMES, -1, -1, -1))
        return looks[-1][:, :, -1]

    def _look(
        self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
    ) -> tuple[tuple[Tensor, ...], Tensor, Tensor, Tensor, Tensor | None]:
        """Positions by look, features of the closer ones, ground, measures, radii if zoomed."""
        rough, ground, measures = self.first(frames_BKHW3)
        if prompts_BN2 is not None:
            prompts = prompts_BN2[:, :, None].expand_as(rough)
            rough = torch.where(prompts.isnan(), rough, prompts)
        images = frames_BKHW3.permute(0, 1, 4, 2, 3).float() / 127.5 - 1
        near, _ = self.closer(images, rough)
        exact, features = self.closer(images, near)
        if self.zoomed is None:
            return (rough, near, exact), features, ground, measures, None
        zoomed, radii = self.zoomed(images, exact, features)
        return (rough, near, exact, zoomed), features, ground, measures, radii


class PerceptionNetwork(Network):
    """A network whose first state is made of what its only eye reads."""

    @abstractmethod
    def begin(self, reading: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from a reading and, where a final frame is seen, the positions there."""


def looked(
    eye: Eye, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
) -> tuple[PerceptionOutput, Tensor | None]:
    """Read the observed frames, and positions [B, N, 2] in a final one where there is one."""
    reading: PerceptionOutput = eye(frames_BKHW3[:, :OBSERVED_FRAMES], prompts_BN2)
    if frames_BKHW3.shape[1] == OBSERVED_FRAMES:
        return reading, None
    return reading, eye.at_rest(frames_BKHW3[:, OBSERVED_FRAMES])


def _attended(values: Tensor, seen: tuple[int, int]) -> Tensor:
    """Positions [B, N, K, 2] that cells propose relative to themselves, weighed by a softmax."""
    cells = values.shape[-1]
    proposals = values.float().unflatten(1, (*seen, 3))
    centres = cell_centres(cells).to(values.device)
    weights = proposals[:, :, :, 0].flatten(3).softmax(dim=-1)
    points = proposals[:, :, :, 1:] * (2 / cells) + centres
    return (weights[:, :, :, None] * points.flatten(4)).sum(dim=-1)
