"""NPE, the neural physics engine (Chang et al., 2017): pairwise effects of neighbours.

It predicts the change of velocity of every ball from its two last states, and integrates. Details
from the code of the publication: five layers of 50 units in the encoder of pairs and in the
decoder; the bowl's shape and the angular velocity are inputs here, as the paper adds them.
"""

import torch
from torch import Tensor

from training.baselines.interaction import perceptron
from training.baselines.learner import Learner, LearnerForecast
from training.baselines.states import VELOCITY_UNIT, States

GIVEN = 2
"""States that a step is predicted from."""
HIDDEN = 50
LAYERS = 5
NEIGHBOURHOOD = 0.75
"""Distance in halves of the frame within which balls act on each other: 3.5 of their radii."""
CHANGE_UNIT = 0.1
"""Scale of changes of velocity, in VELOCITY_UNIT."""


class Npe(Learner[States]):
    """Neural physics engine.

    Parameters
    ----------
    angular_velocity
        Whether it sees and predicts angular velocity.
    """

    def __init__(self, *, angular_velocity: bool) -> None:
        super().__init__()
        self.sees_spin = angular_velocity
        moving = 7 if angular_velocity else 4
        seen = GIVEN * (moving + 3)
        hidden = [HIDDEN] * LAYERS
        self.encoder = perceptron((2 * seen, *hidden), rectified_end=True)
        self.decoder = perceptron((HIDDEN + seen, *hidden, moving - 2))

    def loss(self, given: States, progress: float) -> Tensor:  # noqa: ARG002 - the same all the time
        """Squared error of the change after the first states of every sequence."""
        change = self._change(given.until(GIVEN))
        velocity, spin = (
            part[:, :, GIVEN] - part[:, :, GIVEN - 1] for part in (given.velocities, given.spins)
        )
        truth = torch.cat([velocity / VELOCITY_UNIT, spin], dim=-1) / CHANGE_UNIT
        return (change - truth[..., : change.shape[-1]]).square().sum(-1).mean()

    def forecast(self, given: States, horizon: int) -> LearnerForecast:
        """Start from the true states of t = -3..0 and integrate."""
        known = given.until(4)
        positions, spins = [known.positions[:, :, -1]], [known.spins[:, :, -1]]
        last = known.last(GIVEN)
        for _ in range(horizon - 1):
            last = self._after(last)
            positions.append(last.positions[:, :, -1])
            spins.append(last.spins[:, :, -1])
        return LearnerForecast.of(
            torch.stack(positions, dim=2), torch.stack(spins, dim=2) if self.sees_spin else None
        )

    def _after(self, last: States) -> States:
        change = CHANGE_UNIT * self._change(last)
        velocity = last.velocities[:, :, -1] + VELOCITY_UNIT * change[..., :2]
        position = last.positions[:, :, -1] + velocity
        spin = last.spins[:, :, -1] + (change[..., 2:] if self.sees_spin else 0.0)
        return States(
            _appended(last.positions, position),
            _appended(last.velocities, velocity),
            _appended(last.spins, spin),
            last.bowl,
        ).last(GIVEN)

    def _change(self, last: States) -> Tensor:
        """Predict the change of velocity, and of spin, of every ball [B, N, 2 or 5]."""
        seen = last.per_ball(angular_velocity=self.sees_spin).flatten(2)
        balls = seen.shape[1]
        if balls == 1:
            effects = seen.new_zeros(*seen.shape[:2], HIDDEN)
        else:
            focus = seen[:, :, None].expand(-1, -1, balls, -1)
            other = seen[:, None].expand(-1, balls, -1, -1)
            encoded = self.encoder(torch.cat([focus, other], dim=-1))
            effects = (encoded * self._near(last.positions[:, :, -1])).sum(dim=2)
        return self.decoder(torch.cat([effects, seen], dim=-1))

    def _near(self, positions: Tensor) -> Tensor:
        """Which pairs [B, N, N, 1] are neighbours; no ball is its own."""
        apart = torch.cdist(positions, positions)
        others = 1 - torch.eye(positions.shape[1])
        return ((apart < NEIGHBOURHOOD).float() * others)[..., None]


def _appended(steps_BNTC: Tensor, new_BNC: Tensor) -> Tensor:
    return torch.cat([steps_BNTC, new_BNC[:, :, None]], dim=2)
