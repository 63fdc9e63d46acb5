"""What ``python -m training`` does for the network of any number of balls."""

import argparse
from pathlib import Path

import torch

from rollcast.scene import Scenario
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


def add_commands(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]",
    processes: argparse.ArgumentParser,
    models: Path,
) -> None:
    """Add ``train-balls``, ``train-encounters`` and ``export-balls``."""
    trained = commands.add_parser(
        "train-balls",
        parents=[processes],
        help="train the perception of any number of balls, from committed models or where a run "
        "stopped",
    )
    trained.add_argument("--batches", type=int, default=20_000, help="of 24 windows")
    trained.add_argument("--models", type=Path, default=models, help="that it begins with")
    trained.set_defaults(run=_train)
    met = commands.add_parser(
        "train-encounters",
        parents=[processes],
        help="teach the balls of that network to meet, from true states; a few minutes",
    )
    met.add_argument("--batches", type=int, default=2500, help="of 64 windows")
    met.add_argument("--models", type=Path, default=models, help="that it begins with")
    met.set_defaults(run=_meet)
    exported = commands.add_parser(
        "export-balls",
        parents=[processes],
        help="export the network for any number of balls and prove the export",
    )
    exported.add_argument("--name", default=RUN)
    exported.add_argument("--version", type=int, default=1)
    exported.add_argument("--models", type=Path, default=models)
    exported.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    exported.set_defaults(run=_export)


def _train(arguments: argparse.Namespace) -> None:
    network = any_ball_from(arguments.models)
    trainer = BallTrainer(network, BallTraining(arguments.batches), runs_folder() / RUN)
    trainer.resume()
    training = trainer.training
    stream = BallStream(
        ball_sources(workers=arguments.workers),
        BallLooks(),
        training.batch_size,
        training.seed,
        trainer.batches,
        REPEATS,
    )
    for batches in trainer.run(stream, workers=1):
        print(f"{batches} of {training.batches} batches", flush=True)


def _meet(arguments: argparse.Namespace) -> None:
    network = any_ball_from(arguments.models)
    several = [part for part in ANY_BALL_DATA if part.source.objects > 1]
    sources = ball_sources(several, workers=arguments.workers)
    training = EncounterTraining(arguments.batches)
    for number, loss in enumerate(train_encounters(network, sources, training), start=1):
        if number % 100 == 0:
            print(f"{number} of {training.batches} batches: loss {loss:.3f}", flush=True)
    folder = runs_folder() / RUN
    folder.mkdir(parents=True, exist_ok=True)
    torch.save(network.rolling.state_dict(), folder / MOTION)


def _export(arguments: argparse.Namespace) -> None:
    path = runs_folder() / RUN / CHECKPOINT
    try:
        kept = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise SystemExit(
            f"no trained weights at {path}: run `python -m training train-balls` first, or name "
            "the folder of its runs with ROLLCAST_RUNS"
        ) from error
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
        arguments.name,
        network,
        kept["batches"] * training.batch_size,
        HORIZON,
        {part.source.name: part.scenes for part in ANY_BALL_DATA},
        training.seed,
    )
    folder = arguments.models / arguments.name / str(arguments.version)
    validation = _sets("validation", 100, arguments.workers)
    test = _sets("test", arguments.scenes, arguments.workers)
    manifest = export_balls(trained, folder, arguments.version, validation, test)
    print(f"{manifest.label}: {manifest.validation_error_px:.2f} px, in {folder}")


def _sets(split: Split, scenes: int, workers: int) -> Sets:
    return {
        balls: evaluation_sets(scenarios, balls, None, split, scenes, workers)
        for balls, scenarios in SCENES.items()
    }
