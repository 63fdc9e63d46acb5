"""Rows of this repository's networks: trained within a study's budget, and the committed models."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import torch

from training.common.run_folder import read_best
from training.common.settings import runs_folder
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.export.load import load_exported
from training.networks.recurrent import Family, Network
from training.objectives.metrics import Forecasts, forecast
from training.recipes.recipe import Recipe
from training.studies.benchmark_case import BenchmarkCase, FixedScenes
from training.studies.rows import (
    BUDGET,
    POSITIONS,
    POSITIONS_AND_SPINS,
    Row,
    RowResult,
    StudyBudget,
)

COMPACT_ARCHITECTURE = "compact, 8 x 8 x 128 state"
ARCHITECTURES = {
    "compact": COMPACT_ARCHITECTURE,
    "field": "FieldNet, explicit state",
    "perception_init": "perception-initialised, 8 x 8 x 128 state",
}
"""Architecture of every preset, in words."""
FULL_SUPERVISION = "ground, heights, 3-D velocities, angular velocities"
"""Supervision of the committed models beyond the paper's."""


def ours(recipe: Recipe, member: str, method: str) -> Row:
    """Return a network of ours, trained from random weights within the tables' budget.

    Its whole family is trained at once, in one training for all scenarios, and serves its other
    members' rows too.

    Parameters
    ----------
    recipe
        Of one kind of scene a scenario.
    """

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:
        network, trainer = _trained(recipe, member, budget)
        made = _seeing(network, test, recipe.task.final_step)
        return RowResult(made, trainer.optimisation.batches, trainer.converged)

    def fits(case: BenchmarkCase) -> bool:
        seen = {share.source.override for share in recipe.data}
        return case.objects == recipe.task.objects and case.override in seen

    return _compact(method, measure, recipe, fits)


def ours_trained_to_each(recipes: Mapping[int, Recipe], member: str, method: str) -> Row:
    """Return networks of ours of which each forecasts only as far as it was trained.

    Parameters
    ----------
    recipes
        By T, the last step of their training.
    """

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:
        made: dict[int, Forecasts] = {}
        ends: list[bool | None] = []
        batches = 0
        for steps, recipe in recipes.items():
            network, trainer = _trained(recipe, member, budget)
            made[steps] = _seeing(network, test)
            ends.append(trainer.converged)
            batches = trainer.optimisation.batches
        whole = made[max(made)]
        begin = 0
        for steps in sorted(made):
            for name in ("positions", "angular_velocities"):
                getattr(whole, name)[:, :, begin:steps] = getattr(made[steps], name)[
                    :, :, begin:steps
                ]
            begin = steps
        return RowResult(whole, batches, None if None in ends else all(ends))

    def fits(case: BenchmarkCase) -> bool:
        return case.objects == recipes[max(recipes)].task.objects

    return _compact(method, measure, recipes[max(recipes)], fits)


def _compact(
    method: str,
    measure: Callable[[FixedScenes, StudyBudget], RowResult],
    recipe: Recipe,
    fits: Callable[[BenchmarkCase], bool],
) -> Row:
    supervision = POSITIONS_AND_SPINS if recipe.task.angular_velocity else POSITIONS
    return Row(
        method,
        measure,
        COMPACT_ARCHITECTURE,
        supervision,
        learns=True,
        given_states=False,
        fits=fits,
    )


def _trained(recipe: Recipe, member: str, budget: StudyBudget) -> tuple[Network, Trainer]:
    whole = replace(
        recipe,
        sequences=budget.of(BUDGET) * len(recipe.data),
        seed=recipe.seed + budget.seed - 1,
    )
    folder = runs_folder() / "studies" / (whole.name + budget.suffix(BUDGET))
    trainer = Trainer(whole, folder, TrainerConfig(simulators=budget.workers))
    trainer.run()
    network = whole.build().networks()[member]
    network.load_state_dict(read_best(folder)["weights"][member])
    return network, trainer


def shipped(folder: Path) -> Row:
    """Return a committed model, with the budget that it has had."""
    manifest, network = load_exported(folder)
    sequences = manifest.training["sequences"]
    assert isinstance(sequences, int)

    def measure(test: FixedScenes, budget: StudyBudget) -> RowResult:  # noqa: ARG001
        return RowResult(_seeing(network, test, manifest.final_step))

    def fits(case: BenchmarkCase) -> bool:
        return case.objects == manifest.objects

    return Row(
        manifest.label,
        measure,
        ARCHITECTURES[manifest.preset],
        FULL_SUPERVISION,
        learns=False,
        given_states=False,
        fits=fits,
        sequences=sequences,
    )


def _seeing(network: Network, test: FixedScenes, final_step: int | None = None) -> Forecasts:
    alone = Family({"it": network})
    windows, horizon = test.windows, test.case.horizon
    if final_step is not None:
        windows, horizon = test.windows_until(final_step), final_step + 1
    return forecast(alone, windows, horizon, torch.device("cpu"))["it"]
