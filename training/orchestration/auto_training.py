"""Trains every family of models in rounds, for as long as it is left running.

A round is a training of its own that begins with the family's committed models. An interrupted
round is continued first, then families that have no round yet begin theirs, in order, and then
the next round goes to the family whose last one lowered its validation error most. All rounds
show the same number of sequences.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rollcast.manifest import MANIFEST_FILE, Manifest
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.engine.warm_start import Initial
from training.export.load import read_initial
from training.recipes.field import (
    field_one_ball,
    field_one_ball_interpolation,
    field_several_balls,
    field_several_balls_interpolation,
)
from training.recipes.perception_init import (
    perception_init_one_ball,
    perception_init_one_ball_interpolation,
    perception_init_several_balls,
    perception_init_several_balls_interpolation,
)
from training.recipes.recipe import Recipe, continued
from training.reporting.results import committed

OUTCOME = "outcome.json"
LEAST_GAIN = 0.01
"""Share of the error that a round has to take away for another one to follow."""


@dataclass(frozen=True)
class Line:
    """A family of models and where its first round begins.

    Attributes
    ----------
    recipe
        From nothing.
    parents
        Models that the first round begins with when the family has none of its own.
    """

    recipe: Recipe
    parents: tuple[str, ...] = ()


@dataclass(frozen=True)
class RoundResult:
    """Result of a finished round: mean validation errors in pixels."""

    error_before_px: float | None
    error_px: float

    @property
    def gain(self) -> float:
        """Share of the error that the round took away; all of it in a first round."""
        return 1 - self.error_px / self.error_before_px if self.error_before_px else 1.0


@dataclass(frozen=True)
class Round:
    """A round to train: its line, number, folder and recipe."""

    line: Line
    number: int
    folder: Path
    recipe: Recipe


def lines() -> tuple[Line, ...]:
    """Return every family that ships, in the order of their first rounds."""
    return (
        Line(field_one_ball()),
        Line(field_several_balls(2), parents=("fieldnet",)),
        Line(field_several_balls(3), parents=("fieldnet-2",)),
        Line(field_one_ball_interpolation(), parents=("fieldnet",)),
        Line(field_several_balls_interpolation(2), parents=("fieldnet-2",)),
        Line(field_several_balls_interpolation(3), parents=("fieldnet-3",)),
        # The perception comes from the first, parts that the first lacks from the others.
        Line(perception_init_one_ball(), parents=("fieldnet",)),
        Line(perception_init_one_ball_interpolation(), parents=("fieldnet", "dispnet")),
        Line(
            perception_init_several_balls(2), parents=("fieldnet-2", "posnet", "dispnet", "probnet")
        ),
        Line(
            perception_init_several_balls(3),
            parents=("fieldnet-3", "posnet-2", "dispnet-2", "probnet-2"),
        ),
        Line(perception_init_several_balls_interpolation(2), parents=("fieldnet-2", "interpnet")),
        Line(perception_init_several_balls_interpolation(3), parents=("fieldnet-3", "interpnet-2")),
    )


def next_rounds(known: Sequence[Line], folder: Path, models: Path, sequences: int) -> list[Round]:
    """Choose the next rounds; none if no family improves enough.

    The most urgent round comes first. None starts from the result of another one, so they can be
    trained side by side.

    Parameters
    ----------
    folder
        Folder of the rounds.
    sequences
        Budget of a round.
    """
    begun = {line.recipe.name: _rounds(folder / line.recipe.name) for line in known}
    interrupted = [
        _round(line, len(rounds) - 1, rounds[-1], models, sequences)
        for line in known
        if (rounds := begun[line.recipe.name]) and not (rounds[-1] / OUTCOME).exists()
    ]
    if interrupted:
        return interrupted
    new: list[Line] = []
    for line in known:
        made = {member.name for earlier in new for member in earlier.recipe.members}
        if not begun[line.recipe.name] and not made & set(line.parents):
            new.append(line)
    if new:
        return [_round(line, 0, folder / line.recipe.name / "0", models, sequences) for line in new]
    gains = {name: read_outcome(rounds[-1]).gain for name, rounds in begun.items()}
    gaining = [line for line in known if gains[line.recipe.name] >= LEAST_GAIN]
    gaining.sort(key=lambda line: gains[line.recipe.name], reverse=True)
    return [_following(line, folder, models, sequences) for line in gaining]


def _following(line: Line, folder: Path, models: Path, sequences: int) -> Round:
    name = line.recipe.name
    number = len(_rounds(folder / name))
    return _round(line, number, folder / name / str(number), models, sequences)


def _rounds(folder: Path) -> list[Path]:
    return sorted(folder.glob("[0-9]*"), key=lambda path: int(path.name))


def _round(line: Line, number: int, folder: Path, models: Path, sequences: int) -> Round:
    recipe = replace(line.recipe, sequences=sequences, seed=line.recipe.seed + number)
    own = committed_errors(recipe, models)
    if own is not None:
        recipe = continued(recipe)
    elif line.parents and recipe.explicit is None:
        # Fresh heads on a trained state.
        recipe = replace(recipe, heads_alone=0.05)
    return Round(line, number, folder, recipe)


def committed_errors(recipe: Recipe, models: Path) -> Mapping[str, float] | None:
    """Return the validation errors of a recipe's models; None when one is missing."""
    manifests = [Manifest.read(folder / MANIFEST_FILE) for folder in own_models(recipe, models)]
    if len(manifests) < len(recipe.members):
        return None
    return {manifest.name: manifest.validation_error_px for manifest in manifests}


def own_models(recipe: Recipe, models: Path) -> list[Path]:
    """Folders of a recipe's models; those of another preset only share their names."""
    found = [newest(models, member.name) for member in recipe.members]
    return [
        folder
        for folder in found
        if folder is not None and Manifest.read(folder / MANIFEST_FILE).preset == recipe.preset
    ]


def newest(models: Path, name: str) -> Path | None:
    """Folder of a model's default version; None when there is none."""
    return next((folder for folder in committed(models) if folder.parent.name == name), None)


def initial_of(chosen: Round, models: Path) -> list[Initial]:
    """Return the initial networks of a round: committed models, or the parents of its line."""
    own = own_models(chosen.recipe, models)
    parents = [folder for name in chosen.line.parents if (folder := newest(models, name))]
    return [read_initial(folder) for folder in own or parents]


def train(chosen: Round, models: Path, config: TrainerConfig) -> RoundResult:
    """Train a round to its end and return its result."""
    before = committed_errors(chosen.recipe, models)
    trainer = Trainer(chosen.recipe, chosen.folder, config, initial_of(chosen, models))
    error = trainer.run()
    mean = None if before is None else sum(before.values()) / len(before)
    return RoundResult(mean, error)


def finish(chosen: Round, outcome: RoundResult) -> None:
    """Record the result of a round whose models are exported, so it is not repeated."""
    (chosen.folder / OUTCOME).write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")


def read_outcome(folder: Path) -> RoundResult:
    """Read the result of a finished round."""
    return RoundResult(**json.loads((folder / OUTCOME).read_text("utf-8")))
