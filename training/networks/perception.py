"""Perception of FieldNet: frames to a ground map and the initial states of the balls.

A coarse detector on whole frames predicts the ground map and approximate positions. A refiner on
patches around the balls, all observed frames stacked, predicts positions to fractions of a pixel
and features of the texture's rotation. With a zoomed refiner, perception also measures the radius
of each ball, and refines its position on a patch that the ball just fills.

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
"""Size of the features that the refiner predicts for every ball."""

PATCH = 32
"""Width of a refiner's patch in samples."""

PATCH_HALF_WIDTH = 20 / PIXEL_UNIT
"""Half of 40 pixels: the largest ball of all scenarios, and some ground around it."""

ZOOM_MARGIN = 4 / PIXEL_UNIT
"""Ground around the ball in a zoomed patch: 4 pixels, including motion blur."""

USUAL_RADIUS, SMALLEST_SEEN, LARGEST_SEEN = 8 / PIXEL_UNIT, 1 / PIXEL_UNIT, 40 / PIXEL_UNIT
"""Radius that an untrained zoomed refiner predicts, and the limits of its predictions."""

STEEPEST = 0.3
"""Lower bound of a normal's z component in divisions."""

SMALLEST_RADIUS = 0.02
"""Lower bound of radii in divisions, halves of the frame, for untrained networks."""

SAMPLE_AHEAD = (0.0, 0.5, 1.0)
"""Offsets in frames at which the ground map is sampled for the initial velocity."""


def of_each(module: nn.Module, x: Tensor) -> Tensor:
    """Apply a perceptron along the last axis.

    It is one matrix product, because an exported graph keeps parameter names only for those.
    """
    return module(x.flatten(0, -2)).unflatten(0, x.shape[:-1])


def scene_constants_of(half_width_m: float, radius_m: float) -> Float[np.ndarray, "2"]:
    """Scene constants, scaled for the inputs of networks; the first is zero for bowls."""
    return np.array([5 * (half_width_m - BOWL_HALF_WIDTH_M), 5 * radius_m])


def radius_of(scene_constants: Tensor) -> Tensor:
    """Ball radius [..., 1] in halves of the frame, from :func:`scene_constants_of`."""
    scale, radius = scene_constants.split(1, dim=-1)
    return (radius / 5) / (BOWL_HALF_WIDTH_M + scale / 5)


def rise_along(normal_xy: Tensor, flat_velocity: Tensor) -> Tensor:
    """Vertical velocity [..., 1] of a ball on the ground: no velocity along the normal."""
    normal_z = (1 - normal_xy.square().sum(dim=-1, keepdim=True)).clamp(min=STEEPEST**2).sqrt()
    return -(normal_xy * flat_velocity).sum(dim=-1, keepdim=True) / normal_z


def rolling_spin(normal_xy: Tensor, velocity: Tensor, radius: Tensor) -> Tensor:
    """Angular velocity [..., 3] of a ball that rolls without slipping: omega = n x v / r.

    Parameters
    ----------
    normal_xy
        Image x and y of the ground's unit normal [..., 2].
    velocity
        Displacement [..., 3] per frame, image axes.
    radius
        Radius [..., 1], halves of the frame.

    Returns
    -------
    Units of 20 rad/s, world axes: world y is image -y.
    """
    nz = (1 - normal_xy.square().sum(dim=-1)).clamp(min=0).sqrt()
    (nx, ny), (vx, vy, vz) = normal_xy.unbind(-1), velocity.unbind(-1)
    turned = torch.stack([-ny * vz + nz * vy, nz * vx - nx * vz, -nx * vy + ny * vx], dim=-1)
    return turned * (FRAME_RATE_HZ / ANGULAR_VELOCITY_UNIT) / radius.clamp(min=SMALLEST_RADIUS)


def sampled(ground_B3GG: Tensor, points_BMA2: Tensor) -> Tensor:
    """Ground map [B, M, A, 3] at image points, bilinear; outside the frame, that of its border."""
    values = functional.grid_sample(
        ground_B3GG, points_BMA2, padding_mode="border", align_corners=False
    )
    return values.permute(0, 2, 3, 1)


class CoarseDetector(nn.Module):
    """Whole frames to ground map, scene constants and approximate positions, through 8 x 8 cells.

    The inputs include the coordinates of every pixel, which mostly determine a bowl's ground.

    Parameters
    ----------
    objects
        Number of balls.
    """

    place: Tensor

    def __init__(self, objects: int) -> None:
        super().__init__()
        fine, middle, coarse = 48, 96, 128
        self.shape = (objects, OBSERVED_FRAMES)
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
        self.scene_constants = nn.Linear(coarse, 2)

    def forward(self, frames_BKHW3: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Positions [B, N, K, 2], ground map [B, 3, 32, 32] and scene constants [B, 2]."""
        ground, scene_constants, _, at_16 = self.trunk(frames_BKHW3)
        return _attended(self.where(at_16), self.shape), ground, scene_constants

    def trunk(self, frames_BKHW3: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Ground map, scene constants, and rectified features of 32 x 32 and of 16 x 16 cells."""
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
        scene_constants = self.scene_constants(at_8.relu().float().mean(dim=(2, 3))).float()
        return ground, scene_constants, at_32.relu(), at_16.relu()


def patch_layers(size: int) -> nn.Sequential:
    """Return the layers from the patches of a ball, ``size`` samples wide, to features [256]."""
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


class PositionRefiner(nn.Module):
    """Patches around the balls, all frames of one ball stacked, to corrections of positions.

    Parameters
    ----------
    features
        Size of the features of other properties, such as rotation and occlusion; may be 0.
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
            Half-width of every ball's patch relative to the default; corrections scale with it.
        """
        batch, objects, frames = around_BNK2.shape[:3]
        # Only the correction is trained, not the position of the patch.
        centres = around_BNK2.detach()
        grid = self.grid
        if zoom_BN is not None:
            zooms = zoom_BN[:, None].expand(-1, frames, -1).flatten(0, 1)
            grid = zooms[..., None, None, None] * grid
        grid = grid + centres.transpose(1, 2).flatten(0, 1)[:, :, None, None]
        # The patches of all balls form one column, so that each frame is sampled once.
        patches = functional.grid_sample(
            images_BK3HW.flatten(0, 1), grid.flatten(1, 2),
            padding_mode="border", align_corners=False,
        )  # fmt: skip
        patches = patches.reshape(batch, frames, 3, objects, PATCH, PATCH)
        stacked = patches.permute(0, 3, 1, 2, 4, 5).reshape(-1, 3 * frames, PATCH, PATCH)
        hidden = self.layers(stacked.contiguous(memory_format=torch.channels_last))
        correction = self.correction(hidden).float().reshape(batch, objects, frames, 2)
        if zoom_BN is not None:
            correction = correction * zoom_BN[..., None, None]
        corrected = centres + correction
        if self.features is None:
            return corrected, correction.new_zeros(batch, objects, 0)
        return corrected, self.features(hidden).float().reshape(batch, objects, -1)


class ZoomedRefiner(nn.Module):
    """Radii of the balls, and a refinement of their positions on patches of that size."""

    def __init__(self) -> None:
        super().__init__()
        self.size = nn.Linear(FEATURES, 1)
        nn.init.zeros_(self.size.weight)
        nn.init.zeros_(self.size.bias)
        self.refiner = PositionRefiner(0)

    def forward(
        self, images_BK3HW: Tensor, around_BNK2: Tensor, features_BNF: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Corrected positions [B, N, K, 2] and radii [B, N], in halves of the frame."""
        radii = USUAL_RADIUS * of_each(self.size, features_BNF)[..., 0].exp()
        radii = radii.clamp(SMALLEST_SEEN, LARGEST_SEEN)
        zoom = (radii.detach() + ZOOM_MARGIN) / PATCH_HALF_WIDTH
        positions, _ = self.refiner(images_BK3HW, around_BNK2, zoom)
        return positions, radii


class Perception(nn.Module):
    """Coarse detector, two passes of the refiner, and the states of the balls at t = 0.

    Both passes of the refiner have the same weights; the patches of the second one are centred.
    Vertical and angular velocities are predicted as differences from rolling without slipping.

    Parameters
    ----------
    objects
        Number of balls.
    zoomed
        Refiner of a third pass, which measures radii, or None.
    """

    def __init__(self, objects: int, zoomed: ZoomedRefiner | None = None) -> None:
        super().__init__()
        self.first = CoarseDetector(objects)
        self.closer = PositionRefiner(FEATURES)
        size = FEATURES + 2 * (OBSERVED_FRAMES - 1) + 2 + 3 * len(SAMPLE_AHEAD) + 2 + 4
        self.state = nn.Sequential(
            nn.Linear(size, 192), nn.SiLU(), nn.Linear(192, 192), nn.SiLU(), nn.Linear(192, 9)
        )
        self.zoomed = zoomed

    def forward(self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None) -> PerceptionOutput:
        """Ground map and ball states from the observed frames uint8 [B, 4, 128, 128, 3].

        Parameters
        ----------
        prompts_BN2
            Approximate positions of the selected balls in the last frame, halves of the frame; NaN
            for balls that the coarse detector finds.
        """
        passes, features, ground, scene_constants, radii = self._find(frames_BKHW3, prompts_BN2)
        exact = passes[-1]
        with full_precision(exact.device):
            last = exact[:, :, -1]
            shifts = exact[:, :, 1:] - exact[:, :, :-1]
            ahead = torch.stack([last + a * shifts[:, :, -1] for a in SAMPLE_AHEAD], dim=2)
            ground_features = sampled(ground, ahead.detach())
            normal_xy, height = ground_features[:, :, 0, :2], ground_features[:, :, 0, 2:]
            constants = scene_constants[:, None].expand(-1, last.shape[1], -1)
            rise = rise_along(normal_xy, shifts[:, :, -1])
            moving = torch.cat([shifts[:, :, -1], rise], dim=-1)
            rolling = rolling_spin(normal_xy, moving, radius_of(constants))
            inputs = [
                features, 10 * shifts.flatten(2), last, ground_features.flatten(2), constants,
                10 * rise, rolling,
            ]  # fmt: skip
            change = of_each(self.state, torch.cat(inputs, dim=-1))
            height = height + 0.1 * change[..., 2:3]
            centres = torch.cat([last + 0.01 * change[..., :2], height], dim=-1)
            flat = 0.03 * change[..., 3:5]
            velocities = moving + torch.cat([flat, 0.1 * change[..., 5:6]], dim=-1)
            spins = rolling + change[..., 6:]
        return PerceptionOutput(
            passes, ground, scene_constants, centres, velocities, spins, features, radii
        )

    def at_rest(self, frame_BHW3: Tensor) -> Tensor:
        """Positions [B, N, 2] in a single frame, which is repeated as for balls at rest.

        No training is specific to this; every training contains balls at rest.
        """
        passes, *_ = self._find(frame_BHW3[:, None].expand(-1, OBSERVED_FRAMES, -1, -1, -1))
        return passes[-1][:, :, -1]

    def _find(
        self, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
    ) -> tuple[tuple[Tensor, ...], Tensor, Tensor, Tensor, Tensor | None]:
        """Positions after each pass, features, ground map, scene constants, radii if zoomed."""
        rough, ground, scene_constants = self.first(frames_BKHW3)
        if prompts_BN2 is not None:
            prompts = prompts_BN2[:, :, None].expand_as(rough)
            rough = torch.where(prompts.isnan(), rough, prompts)
        images = frames_BKHW3.permute(0, 1, 4, 2, 3).float() / 127.5 - 1
        near, _ = self.closer(images, rough)
        exact, features = self.closer(images, near)
        if self.zoomed is None:
            return (rough, near, exact), features, ground, scene_constants, None
        zoomed, radii = self.zoomed(images, exact, features)
        return (rough, near, exact, zoomed), features, ground, scene_constants, radii


class PerceptionNetwork(Network):
    """Base of networks whose initial state comes from the outputs of one perception."""

    @abstractmethod
    def begin(self, perceived: PerceptionOutput, finals_BN2: Tensor | None) -> State:
        """h_0 from perception outputs and, with a final frame, the positions there."""


def perceive(
    perception: Perception, frames_BKHW3: Tensor, prompts_BN2: Tensor | None = None
) -> tuple[PerceptionOutput, Tensor | None]:
    """Return the outputs for the observed frames, and final positions [B, N, 2] if given."""
    perceived: PerceptionOutput = perception(frames_BKHW3[:, :OBSERVED_FRAMES], prompts_BN2)
    if frames_BKHW3.shape[1] == OBSERVED_FRAMES:
        return perceived, None
    return perceived, perception.at_rest(frames_BKHW3[:, OBSERVED_FRAMES])


def _attended(values: Tensor, shape: tuple[int, int]) -> Tensor:
    """Positions [B, N, K, 2]: the softmax-weighted mean of the cells' proposals."""
    cells = values.shape[-1]
    proposals = values.float().unflatten(1, (*shape, 3))
    centres = cell_centres(cells).to(values.device)
    weights = proposals[:, :, :, 0].flatten(3).softmax(dim=-1)
    points = proposals[:, :, :, 1:] * (2 / cells) + centres
    return (weights[:, :, :, None] * points.flatten(4)).sum(dim=-1)
