"""IFS, the interaction network from states (Watters et al., 2017): VIN's dynamics on true states.

The first four true states become codes; the rest is as in VIN. The paper trains it on sixteen
steps after them and lowers the rate as it does its own (section 5.1).
"""

import torch
from torch import Tensor, nn

from training.baselines.interaction import CODE, HISTORY, InteractionDynamics, annealed_weights
from training.baselines.learner import Learner, LearnerForecast
from training.baselines.states import VELOCITY_UNIT, States

ROLLED_OUT = 16
FRAMES = HISTORY + ROLLED_OUT
"""States of a training sequence."""


class Ifs(Learner[States]):
    """Interaction network from states.

    Parameters
    ----------
    angular_velocity
        Whether it sees and predicts angular velocity.
    """

    def __init__(self, *, angular_velocity: bool) -> None:
        super().__init__()
        self.sees_spin = angular_velocity
        moving = 7 if angular_velocity else 4
        self.encoder = nn.Linear(moving + 3, CODE)
        self.dynamics = InteractionDynamics()
        self.decoder = nn.Linear(CODE, moving)

    def loss(self, given: States, progress: float) -> Tensor:
        """Squared errors of the steps, and of the given states as their codes tell them."""
        truth = self._truth(given)
        codes = self._codes(given)
        given_error = (self.decoder(codes) - truth[:, :, :HISTORY]).square().sum(-1).mean()
        weights = annealed_weights(truth.shape[2] - HISTORY, progress)
        later = truth[:, :, HISTORY : HISTORY + len(weights)]
        rolled = self.decoder(self.dynamics.roll_out(codes, len(weights)))
        errors = (rolled - later).square().sum(-1).mean(dim=(0, 1))
        return given_error + (weights * errors).sum()

    def forecast(self, given: States, horizon: int) -> LearnerForecast:
        """Start from the true states of t = -3..0."""
        later = self.decoder(self.dynamics.roll_out(self._codes(given), horizon - 1))
        now = self._truth(given)[:, :, HISTORY - 1 : HISTORY]
        moving = torch.cat([now, later], dim=2)
        return LearnerForecast.of(moving[..., :2], moving[..., 4:] if self.sees_spin else None)

    def _codes(self, given: States) -> Tensor:
        return self.encoder(given.until(HISTORY).per_ball(angular_velocity=self.sees_spin))

    def _truth(self, given: States) -> Tensor:
        """Return the true values of the predicted quantities of every ball [B, N, T, 4 or 7]."""
        moving = [given.positions, given.velocities / VELOCITY_UNIT]
        return torch.cat([*moving, *([given.spins] if self.sees_spin else [])], dim=-1)
