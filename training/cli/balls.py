"""Commands for the network that follows any number of balls."""

from pathlib import Path
from typing import Annotated, TypeAlias

import torch
import typer

from rollcast.scene import Scenario
from training.cli.options import CORES, MODELS, TestScenes, Workers, failed
from training.common.settings import runs_folder
from training.data.ball_windows import BallLooks, BallStream
from training.data.splits import Split
from training.engine.ball_trainer import CHECKPOINT, BallTrainer, BallTraining
from training.engine.encounter_trainer import EncounterTraining, train_encounters
from training.evaluation.evaluate import evaluation_sets
from training.export.ball_artefact import Sets, TrainedBalls, export_balls
from training.export.load import any_ball_from
from training.networks.any_ball import AnyBallNet
from training.recipes.any_ball import ANY_BALL_DATA, ball_sources

RUN = "any-ball"
"""Folder of the run, and name of its network."""
MOTION = "rolling.pt"
"""Weights of the motion in the run's folder, once encounters are taught."""
REPEATS = 3
"""Times that a painted window is seen."""
SCENES: dict[int, tuple[Scenario, ...]] = {
    1: ("hemisphere", "ellipsoid", "heightfield"),
    2: ("ellipsoid",),
    3: ("ellipsoid",),
}
"""Scenarios that are measured, by number of balls."""
HORIZON = 40
"""Steps of the longest rollouts that trained the motion it begins with."""


Start: TypeAlias = Annotated[
    Path, typer.Option("--models", help="committed models whose weights the network starts from")
]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("train-balls")(train_balls)
    app.command("train-encounters")(train_balls_to_collide)
    app.command("export-balls")(export)


def train_balls(
    batches: Annotated[int, typer.Option(min=1, help="batches of 24 windows")] = 20_000,
    models: Start = MODELS,
    workers: Workers = CORES,
) -> None:
    """Train the perception of any number of balls; resumes a run that was stopped."""
    network = any_ball_from(models)
    trainer = BallTrainer(network, BallTraining(batches), runs_folder() / RUN)
    trainer.resume()
    training = trainer.training
    stream = BallStream(
        ball_sources(workers=workers),
        BallLooks(),
        training.batch_size,
        training.seed,
        trainer.batches,
        REPEATS,
    )
    for done in trainer.run(stream, workers=1):
        typer.echo(f"{done} of {training.batches} batches")


def train_balls_to_collide(
    batches: Annotated[int, typer.Option(min=1, help="batches of 64 windows")] = 2500,
    models: Start = MODELS,
    workers: Workers = CORES,
) -> None:
    """Train the motion of balls that collide, from true states; takes a few minutes."""
    network = any_ball_from(models)
    several = [part for part in ANY_BALL_DATA if part.source.objects > 1]
    sources = ball_sources(several, workers=workers)
    training = EncounterTraining(batches)
    for number, loss in enumerate(train_encounters(network, sources, training), start=1):
        if number % 100 == 0:
            typer.echo(f"{number} of {training.batches} batches: loss {loss:.3f}")
    folder = runs_folder() / RUN
    folder.mkdir(parents=True, exist_ok=True)
    torch.save(network.rolling.state_dict(), folder / MOTION)


def export(
    name: str = RUN,
    version: Annotated[int, typer.Option(min=1)] = 1,
    models: Annotated[Path, typer.Option(help="folder to export into")] = MODELS,
    scenes: TestScenes = 500,
    workers: Workers = CORES,
) -> None:
    """Export the network for any number of balls and prove the export."""
    path = runs_folder() / RUN / CHECKPOINT
    try:
        kept = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        failed(
            f"no trained weights at {path}: run `python -m training train-balls` first, or name "
            "the folder of its runs with ROLLCAST_RUNS"
        )
    network = AnyBallNet()
    prefix = "module."
    network.load_state_dict(
        {n.removeprefix(prefix): v for n, v in kept["average"].items() if n.startswith(prefix)}
    )
    motion = path.with_name(MOTION)
    if motion.exists():
        network.rolling.load_state_dict(torch.load(motion, map_location="cpu", weights_only=True))
    training = BallTraining(0)
    trained = TrainedBalls(
        name,
        network,
        kept["batches"] * training.batch_size,
        HORIZON,
        {part.source.name: part.scenes for part in ANY_BALL_DATA},
        training.seed,
    )
    folder = models / name / str(version)
    validation = _sets("validation", 100, workers)
    test = _sets("test", scenes, workers)
    manifest = export_balls(trained, folder, version, validation, test)
    typer.echo(f"{manifest.label}: {manifest.validation_error_px:.2f} px, in {folder}")


def _sets(split: Split, scenes: int, workers: int) -> Sets:
    return {
        balls: evaluation_sets(scenarios, balls, None, split, scenes, workers)
        for balls, scenarios in SCENES.items()
    }
