"""FieldNet for any number of balls: detector, patch refiner, and balls that move over the ground.

One set of weights for one to eight balls: all that is said of a ball comes from its own patches
and from the maps under it, and the balls' number is a free axis. Units as in ``perception.py``.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from rollcast.camera import BOWL_HALF_WIDTH_M
from rollcast.trajectory import OBSERVED_FRAMES
from training.common.precision import full_precision
from training.networks.ball_detector import BallDetector
from training.networks.fieldnet import (
    FIRST_VARIANCE_PX2,
    LARGEST_VARIANCE_PX2,
    Ball,
    PairInteraction,
    Rolling,
)
from training.networks.patch_refiner import PatchRefiner
from training.networks.patches import cut_patches, half_widths
from training.networks.perception import (
    FEATURES,
    SAMPLE_AHEAD,
    of_each,
    radius_of,
    rise_along,
    rolling_spin,
    sampled,
)
from training.networks.recurrent import (
    ANGULAR_VELOCITY_UNIT,
    GaussianOutput,
    Observation,
    State,
    logit_of_variance,
    stacked,
)

PASSES = 2
"""Number of refinement passes; the patches of the second one are centred on the first result."""


class Seen(NamedTuple):
    """Outputs of the refiner for every ball, [B, N, ...]."""

    rough: Tensor
    """Positions [B, N, K, 2] in the observed frames, by convolution only."""
    outline: Tensor
    """Positions [B, N, K, 2] by the edges of the balls."""
    edges: Tensor
    """Logits [B, N, K, RAYS, RAY_SAMPLES] of the edge along rays from the rough position."""
    reach: Tensor
    """Half lengths [B, N] of the rays, whose middle is at the radius."""
    places: Tensor
    """Positions [B, N, K, 2], the final estimate."""
    radii: Tensor
    """Radii [B, N]."""
    visible: Tensor
    """Logits [B, N, K] of visibility."""
    log_sigmas: Tensor
    """Logarithms [B, N, 2] of the standard deviations of last position and displacement."""
    features: Tensor
    """Features [B, N, FEATURES]."""


def seen_balls(
    places: Tensor, radii: Tensor, visible: Tensor, log_sigmas: Tensor, features: Tensor
) -> Seen:
    """Return the outputs without the parts that only the loss uses."""
    none = places[..., :0]
    return Seen(none, none, none, none, places, radii, visible, log_sigmas, features)


class Beginning(NamedTuple):
    """The balls at t = 0, [B, N, 3] each."""

    centres: Tensor
    velocities: Tensor
    """Displacements per step of the forecast."""
    spins: Tensor
    """Angular velocities in units of 20 rad/s, world axes."""
    constants: Tensor
    """Constants [B, N, 2] of :func:`training.networks.perception.scene_constants_of` by ball."""


class BallPerception(nn.Module):
    """Frames, and roughly where balls are, to the balls at t = 0."""

    def __init__(self) -> None:
        super().__init__()
        self.detector = BallDetector()
        self.refiner = PatchRefiner()
        seen = FEATURES + 2 * (OBSERVED_FRAMES - 1) + 2 + 3 * len(SAMPLE_AHEAD) + 2 + 4 + 1
        self.state = nn.Sequential(
            nn.Linear(seen, 192), nn.SiLU(), nn.Linear(192, 192), nn.SiLU(), nn.Linear(192, 9)
        )

    def refine(
        self, frames_BKHW3: Tensor, places_BNK2: Tensor, radii_BN: Tensor, passes: int = PASSES
    ) -> Seen:
        """Look closer at balls that are roughly known.

        Parameters
        ----------
        frames_BKHW3
            Square frames of any size.
        """
        # Gradients flow through the content of patches, not through their positions.
        widths, places_BNK2 = half_widths(radii_BN.detach()), places_BNK2.detach()
        patches = cut_patches(frames_BKHW3, places_BNK2, widths)
        seen = self.seen(patches, places_BNK2, widths)
        if passes == 1:
            return seen
        return self.refine(frames_BKHW3, seen.places, seen.radii, passes - 1)

    def seen(self, patches_BNK3PP: Tensor, places_BNK2: Tensor, widths_BN: Tensor) -> Seen:
        """Return the outputs of patches around positions."""
        batch = widths_BN.shape
        said = self.refiner(patches_BNK3PP.flatten(0, 1))
        rough, outline, edges, reach, offsets, log_radius, visible, log_sigmas, features = (
            part.unflatten(0, batch) for part in said
        )
        return Seen(
            places_BNK2 + widths_BN[..., None, None] * rough,
            places_BNK2 + widths_BN[..., None, None] * outline,
            edges,
            widths_BN * reach,
            places_BNK2 + widths_BN[..., None, None] * offsets,
            widths_BN * log_radius.exp(),
            visible,
            log_sigmas + widths_BN.log()[..., None],
            features,
        )

    def begin(
        self, seen: Seen, ground_B3GG: Tensor, scene_B2: Tensor, spacing_B: Tensor
    ) -> Beginning:
        """Return the balls at t = 0; rise and spin are offsets from rolling without slipping.

        Parameters
        ----------
        spacing_B
            Time between two seen frames, in steps of the forecast.
        """
        with full_precision(ground_B3GG.device):
            last = seen.places[:, :, -1]
            shifts = seen.places[:, :, 1:] - seen.places[:, :, :-1]
            shifts = shifts / spacing_B[:, None, None, None]
            ahead = torch.stack([last + a * shifts[:, :, -1] for a in SAMPLE_AHEAD], dim=2)
            under = sampled(ground_B3GG, ahead.detach())
            constants = ball_constants(scene_B2, seen.radii)
            normal_xy = under[:, :, 0, :2]
            rise = rise_along(normal_xy, shifts[:, :, -1])
            moving = torch.cat([shifts[:, :, -1], rise], dim=-1)
            rolling = rolling_spin(normal_xy, moving, radius_of(constants))
            known = [
                seen.features, 10 * shifts.flatten(2), last, under.flatten(2), constants, 10 * rise,
                rolling, spacing_B.log()[:, None, None].expand_as(last[..., :1]),
            ]  # fmt: skip
            said = of_each(self.state, torch.cat(known, dim=-1))
            height = under[:, :, 0, 2:] + 0.1 * said[..., 2:3]
            centres = torch.cat([last + 0.01 * said[..., :2], height], dim=-1)
            flat = 0.03 * said[..., 3:5]
            velocities = moving + torch.cat([flat, 0.1 * said[..., 5:6]], dim=-1)
            return Beginning(centres, velocities, rolling + said[..., 6:], constants)


def ball_constants(scene_B2: Tensor, radii_BN: Tensor) -> Tensor:
    """Constants [B, N, 2] of every ball: the scene's scale, and its own radius in metres."""
    scale = scene_B2[:, None, :1].expand(-1, radii_BN.shape[1], -1)
    radius_m = radii_BN[..., None] * (BOWL_HALF_WIDTH_M + scale / 5)
    return torch.cat([scale, 5 * radius_m], dim=-1)


class AnyBallNet(nn.Module):
    """Perception x rolling with pair interaction, for any number of balls."""

    def __init__(self) -> None:
        super().__init__()
        self.perception = BallPerception()
        self.rolling = Rolling(SizedPairInteraction())
        self.first_covariance = nn.Linear(FEATURES, 3)
        self.covariance_from_sigmas = nn.Linear(2, 3, bias=False)
        nn.init.zeros_(self.first_covariance.weight)
        nn.init.zeros_(self.covariance_from_sigmas.weight)
        with torch.no_grad():
            self.first_covariance.bias[:] = torch.tensor(
                [logit_of_variance(FIRST_VARIANCE_PX2, LARGEST_VARIANCE_PX2)] * 2 + [0.0]
            )
        self.output = GaussianOutput(LARGEST_VARIANCE_PX2)

    def begin(
        self, seen: Seen, ground_B3GG: Tensor, scene_B2: Tensor, spacing_B: Tensor
    ) -> tuple[State, Beginning]:
        """Return h_0 from the refiner's outputs, see :meth:`BallPerception.begin`."""
        balls = self.perception.begin(seen, ground_B3GG, scene_B2, spacing_B)
        return self.state(seen, balls, ground_B3GG, spacing_B), balls

    def state(self, seen: Seen, balls: Beginning, ground_B3GG: Tensor, spacing_B: Tensor) -> State:
        """h_0 of balls at t = 0."""
        with full_precision(ground_B3GG.device):
            params = of_each(self.first_covariance, seen.features.detach())
            log_sigmas = seen.log_sigmas.detach()
            of_velocity = log_sigmas[..., 1:] - spacing_B.log()[:, None, None]
            log_sigmas = torch.cat([log_sigmas[..., :1], of_velocity], dim=-1)
            params = params + of_each(self.covariance_from_sigmas, log_sigmas + 4)
        ball = Ball(balls.centres, balls.velocities, balls.spins, params, balls.constants)
        return State(ground_B3GG, ball.packed())

    def advance(self, state: State) -> State:
        """h_{t+1} from h_t."""
        return State(state.s, self.rolling(Ball.unpacked(state.p), state.s).packed())

    def observe(self, state: State) -> Observation:
        """Observation y_t of a state."""
        ball = Ball.unpacked(state.p)
        numbers = torch.cat([ball.centre[..., :2], ball.covariance_params], dim=-1)
        positions, covariances = self.output(numbers)
        return Observation(positions, covariances, ANGULAR_VELOCITY_UNIT * ball.spin)

    def roll_out(self, state: State, horizon: int) -> Observation:
        """Observations of the steps 0..horizon-1."""
        with full_precision(state.p.device):
            steps = [self.observe(state)]
            for _ in range(horizon - 1):
                state = self.advance(state)
                steps.append(self.observe(state))
            return stacked(steps)


class SizedPairInteraction(PairInteraction):
    """Pair interaction of balls whose radii differ: gaps are less both of them."""

    def reach(self, ball: Ball) -> Tensor:
        """Distance [B, N, N, 1] of the centres of two balls that touch."""
        return ball.radius[:, :, None] + ball.radius[:, None]
