"""Commands for the network that follows any number of balls."""

from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import torch
import typer
from torch.utils.data import DataLoader

from rollcast.scene import Scenario
from training.cli.options import CORES, MODELS, TestScenes, Workers, failed
from training.common.run_folder import BEST, read_best, read_whole
from training.common.settings import runs_folder
from training.data.ball_windows import BallAppearanceMixture, BallStream, validation_windows
from training.data.splits import Split
from training.engine.ball_trainer import BallTrainer, BallTraining
from training.engine.encounter_trainer import EncounterTraining, train_encounters
from training.engine.loop import TrainingStoppedError
from training.engine.motion_trainer import (
    MOTION_PARTS,
    MotionTraining,
    read_windows,
    train_motion,
)
from training.evaluation.any_ball import validation_errors
from training.evaluation.evaluate import evaluation_sets
from training.export.ball_artefact import Sets, TrainedBalls, export_balls
from training.export.kinematic_fit import fit_acceleration_ratio
from training.export.load import any_ball_from
from training.networks.any_ball import AnyBallNet
from training.recipes.any_ball import ANY_BALL_DATA, VALIDATION_DATA, ball_sources

RUN = "any-ball"
"""Folder of the run, and name of its network."""
MOTION = "motion.pt"
"""Weights of the states at t = 0 and of the motion in the run's folder, once they are trained."""
VALIDATION_SCENES = 100
"""Scenes of each kind that fit the covariances of an export."""
VALIDATION_WINDOWS = 120
REPEATS = 3
"""Number of uses of a painted window."""
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
Part = Literal["all", "detector", "refiner"]
"""Parts of the perception that a training changes."""
PARTS: dict[Part, BallTraining] = {
    "all": BallTraining(0),
    "detector": BallTraining(0, learning_rate=6e-4, refined_per_window=0.0, fresh_rate=1.0),
    "refiner": BallTraining(
        0,
        learning_rate=6e-4,
        refined_per_window=3.0,
        trajectory=0.5,
        frozen=(*BallTraining.frozen, "perception.detector."),
        fresh=("perception.refiner.outline.", "perception.refiner.outline_weighing."),
        fresh_rate=2.0,
    ),
}
OTHER_RATES = 0.5
"""Share of the simulated windows that are filmed at another rate (decision 0153)."""
MIXTURES: dict[Part, BallAppearanceMixture] = {
    "all": BallAppearanceMixture(other_rates=OTHER_RATES),
    "detector": BallAppearanceMixture(other_rates=OTHER_RATES),
    "refiner": BallAppearanceMixture(
        paper=0.25, filmed=0.2, restyled=0.25, planar=0.3, other_rates=OTHER_RATES
    ),
}
MOTION_MIXTURE = BallAppearanceMixture(
    paper=0.45, filmed=0.2, restyled=0.25, planar=0.1, other_rates=OTHER_RATES
)


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("train-balls")(train_balls)
    app.command("train-encounters")(train_balls_to_collide)
    app.command("train-ball-motion")(train_ball_motion)
    app.command("export-balls")(export)


def train_balls(
    batches: Annotated[int, typer.Option(min=1, help="batches of 24 windows")] = 20_000,
    part: Annotated[Part, typer.Option(help="part that is trained; the others stay")] = "all",
    init: Annotated[
        Path | None, typer.Option(metavar="RUN", help="run whose best weights it starts from")
    ] = None,
    models: Start = MODELS,
    workers: Workers = CORES,
) -> None:
    """Train the perception of any number of balls; resumes a run that was stopped."""
    training = replace(PARTS[part], batches=batches)
    sources = ball_sources(workers=workers)
    unseen = ball_sources(VALIDATION_DATA, "validation", workers)
    windows = validation_windows(unseen, VALIDATION_WINDOWS)

    def stream(first: int) -> BallStream:
        size = training.batch_size
        return BallStream(sources, MIXTURES[part], size, training.seed, first, REPEATS)

    trainer = BallTrainer(
        any_ball_from(models) if init is None else _trained(init),
        training,
        runs_folder() / RUN,
        stream,
        {part.source.name: part.scenes for part in ANY_BALL_DATA},
        partial(validation_errors, windows=windows),
    )
    try:
        typer.echo(f"best validation error: {trainer.run():.3f} px, kept in {trainer.folder}")
    except TrainingStoppedError as error:
        failed(error)


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
    _write_motion(network)


def train_ball_motion(
    batches: Annotated[int, typer.Option(min=1, help="batches of 128 windows")] = 3000,
    windows: Annotated[
        int, typer.Option(min=24, help="windows that the perception reads")
    ] = 24_000,
    workers: Workers = CORES,
) -> None:
    """Train the states at t = 0 and the motion by trajectories, with the perception of the run."""
    network = _trained(runs_folder() / RUN).eval()
    training = MotionTraining(batches)
    stream = BallStream(ball_sources(workers=workers), MOTION_MIXTURE, 24, training.seed, 0)
    loader = DataLoader(stream, batch_size=None, num_workers=1)
    outputs = read_windows(network, islice(loader, windows // 24), training.seed)
    counts = {balls: len(part.radii) for balls, part in outputs.items()}
    typer.echo(f"windows by number of balls: {counts}")
    for number, loss in enumerate(train_motion(network, outputs, training), start=1):
        if number % 100 == 0:
            typer.echo(f"{number} of {training.batches} batches: loss {loss:.3f}")
    _write_motion(network)


def export(
    name: str = RUN,
    version: Annotated[int, typer.Option(min=1)] = 1,
    models: Annotated[Path, typer.Option(help="folder to export into")] = MODELS,
    scenes: TestScenes = 500,
    workers: Workers = CORES,
) -> None:
    """Export the network for any number of balls and prove the export."""
    folder = runs_folder() / RUN
    network = _trained(folder)
    best = read_best(folder)
    trained = TrainedBalls(
        name, network, best["sequences"], HORIZON, best["scenes"], BallTraining.seed
    )
    target = models / name / str(version)
    validation = _sets("validation", VALIDATION_SCENES, workers)
    test = _sets("test", scenes, workers)
    ratio = fit_acceleration_ratio(VALIDATION_SCENES, workers)
    manifest = export_balls(trained, target, version, validation, test, ratio)
    typer.echo(f"{manifest.label}: {manifest.validation_error_px:.2f} px, in {target}")


def _trained(folder: Path) -> AnyBallNet:
    """Return the network of a run, with its motion if that is trained."""
    try:
        best = read_best(folder)
    except FileNotFoundError:
        failed(
            f"no trained weights at {folder / BEST}: run `python -m training train-balls` first, "
            "or name the folder of its runs with ROLLCAST_RUNS"
        )
    network = AnyBallNet()
    network.load_state_dict(best["weights"])
    motion = folder / MOTION
    if motion.exists():
        network.load_state_dict(network.state_dict() | read_whole(motion))
    return network


def _write_motion(network: AnyBallNet) -> None:
    folder = runs_folder() / RUN
    folder.mkdir(parents=True, exist_ok=True)
    weights = {
        name: value for name, value in network.state_dict().items() if name.startswith(MOTION_PARTS)
    }
    torch.save(weights, folder / MOTION)


def _sets(split: Split, scenes: int, workers: int) -> Sets:
    return {
        balls: evaluation_sets(scenarios, balls, None, split, scenes, workers)
        for balls, scenarios in SCENES.items()
    }
