"""Total loss of a recipe: forecasts from frames, from cached outputs and from true states."""

import torch

from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES
from training.common.precision import mixed_precision
from training.data.windows import Batch
from training.networks.blocks import PIXEL_UNIT
from training.networks.fieldnet import FieldFamily, FieldNet, true_state
from training.networks.perception_state import PerceptionStateFamily
from training.networks.recurrent import (
    Family,
    InitialState,
    Observation,
    PerceptionFamily,
    State,
    in_float32,
)
from training.objectives.losses import final_loss
from training.recipes.recipe import Recipe, horizon_at


class Objective:
    """The loss that a recipe gives a family of networks."""

    def __init__(self, recipe: Recipe, family: Family, device: torch.device) -> None:
        self.recipe = recipe
        self.family = family
        self.device = device

    def loss(self, batch: Batch, progress: float) -> torch.Tensor:
        """Loss of a batch when a share ``progress`` of the budget is gone."""
        recipe = self.recipe
        horizon = horizon_at(recipe.curriculum, progress)
        forecasts = self._forecasts(batch, horizon)
        loss = self._forecast_loss(forecasts, batch, horizon)
        loss = loss + self._perception_loss(forecasts, batch)
        if "from_true_states" in batch:
            assert recipe.explicit is not None
            steps = horizon_at(recipe.explicit.curriculum, progress)
            loss = loss + self._loss_from_true_states(batch["from_true_states"], steps)
        return loss

    def _forecasts(self, batch: Batch, horizon: int) -> dict[str, Observation]:
        """Return every member's forecasts from the frames of a batch or from cached outputs."""
        if "initial_state" in batch:
            (s, p), finals = batch["initial_state"]
            state = State(s.to(self.device), p.to(self.device))
            seen = InitialState(state, None if finals is None else finals.to(self.device))
            return self._forecasts_from(seen, horizon)
        frames = batch["frames"].to(self.device)
        with mixed_precision(self.device):
            if "guidance" not in batch:
                return _all_in_float32(self.family(frames, horizon))
            assert isinstance(self.family, FieldFamily)
            prompts = (batch["guidance"][0].to(self.device) - PIXEL_UNIT) / PIXEL_UNIT
            return _all_in_float32(self.family(frames, horizon, prompts))

    def _forecasts_from(self, initial: InitialState, horizon: int) -> dict[str, Observation]:
        """Return every member's forecasts from initial states, cached or true."""
        assert isinstance(self.family, PerceptionFamily)
        with mixed_precision(self.device):
            return _all_in_float32(self.family.forecast_from(initial, horizon))

    def _forecast_loss(
        self, forecasts: dict[str, Observation], batch: Batch, horizon: int
    ) -> torch.Tensor:
        """Loss of every member's forecasts of a batch."""
        recipe = self.recipe
        positions = batch["positions"].to(self.device)
        spins = batch["angular_velocities"][:, :, :horizon].to(self.device)
        # All members read the same angular velocity.
        loss = recipe.spin_loss(next(iter(forecasts.values())), spins)
        for member in recipe.members:
            made = forecasts[member.name]
            loss = loss + member.weight * member.loss(made, positions[:, :, :horizon])
            if recipe.task.final_step is not None:
                final = positions[:, :, recipe.task.final_step]
                loss = loss + member.weight * final_loss(made, final)
        return loss

    def _perception_loss(
        self, forecasts: dict[str, Observation], batch: Batch
    ) -> torch.Tensor | float:
        """Loss of the perceptions; zero if none is trained."""
        explicit = self.recipe.explicit
        if explicit is None or explicit.perception is None:
            return 0.0
        scene_targets = self._scene_targets(batch)
        shake = radii = None
        if "guidance" in batch:
            shake, radii = (part.to(self.device) / PIXEL_UNIT for part in batch["guidance"][1:])
        outputs = {
            id(made.perception_output): made.perception_output for made in forecasts.values()
        }
        losses = [
            explicit.perception(perceived, scene_targets, shake, radii)
            for perceived in outputs.values()
            if perceived
        ]
        return sum(losses, start=0.0)

    def _loss_from_true_states(self, batch: Batch, horizon: int) -> torch.Tensor:
        """Loss of forecasts that begin with the truth instead of frames."""
        recipe, explicit = self.recipe, self.recipe.explicit
        assert explicit is not None
        centres, ground, constants = self._scene_targets(batch)
        spins = batch["angular_velocities"][:, :, :horizon].to(self.device)
        start = true_state(centres[:, :, :OBSERVED_FRAMES], spins[:, :, 0], ground, constants)
        if isinstance(self.family, PerceptionStateFamily):
            final = None
            if recipe.task.final_step is not None:
                final = centres[:, :, FIRST_FORECAST_FRAME + recipe.task.final_step, :2]
            return self._forecast_loss(
                self._forecasts_from(InitialState(start, final), horizon), batch, horizon
            )
        assert explicit.motion is not None
        loss = torch.zeros((), device=self.device)
        truth = centres[:, :, FIRST_FORECAST_FRAME : FIRST_FORECAST_FRAME + horizon]
        for network in self.family.networks().values():
            assert isinstance(network, FieldNet)
            moved, turned = network.forecast_from(start, horizon)
            turning = Observation(moved[..., :2], None, turned)
            loss = loss + explicit.motion(moved, truth) + recipe.spin_loss(turning, spins)
        return loss

    def _scene_targets(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        assert "scene_targets" in batch
        centres, ground, constants = batch["scene_targets"]
        return centres.to(self.device), ground.to(self.device), constants.to(self.device)


def _all_in_float32(observed: dict[str, Observation]) -> dict[str, Observation]:
    return {name: in_float32(observation) for name, observation in observed.items()}
