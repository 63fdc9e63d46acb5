"""``python -m training simulate | calibrate | train | evaluate | export``."""

import argparse
import os
from pathlib import Path

import torch

from rollcast.scene import SCENARIOS
from training import calibration
from training.artefact import load_exported, read_initial
from training.evaluate import EvaluationSet, evaluation_sets, markdown_table, metric_rows, run
from training.export import Trained, export, with_covariance
from training.recipes import RECIPES
from training.settings import runs_folder
from training.simulate import Source, simulate_split
from training.splits import Split
from training.trainer import BEST, Pace, Trainer

MODELS = Path("models")


def main() -> None:
    """Run one command."""
    arguments = _parser().parse_args()
    arguments.run(arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m training",
        description="Simulates scenes, trains networks and exports them for the service. Data "
        "sets and checkpoints go to the folder that ROLLCAST_RUNS names (default: runs).",
    )
    commands = parser.add_subparsers(required=True)
    processes = argparse.ArgumentParser(add_help=False)
    processes.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes that simulate scenes"
    )

    simulate = commands.add_parser(
        "simulate", parents=[processes], help="simulate scenes of a split; existing ones are kept"
    )
    simulate.add_argument("scenario", choices=SCENARIOS)
    simulate.add_argument("--objects", type=int, choices=(1, 2, 3), default=1)
    simulate.add_argument("--radius", type=float, help="ball radius in metres (default: 0.225)")
    simulate.add_argument("--split", choices=("training", "validation", "test"), default="training")
    simulate.add_argument("--scenes", type=int, default=1000)
    simulate.set_defaults(run=_simulate)

    calibrate = commands.add_parser(
        "calibrate", help="show how hard the simulated world is beside the paper's"
    )
    calibrate.add_argument("--scenes", type=int, default=100)
    calibrate.set_defaults(run=_calibrate)

    train = commands.add_parser(
        "train", parents=[processes], help="train a recipe; goes on where it was stopped"
    )
    train.add_argument("recipe", choices=sorted(RECIPES))
    train.add_argument(
        "--init", type=Path, help="exported model (models/NAME/VERSION) to start from"
    )
    train.set_defaults(run=_train)

    evaluate = commands.add_parser(
        "evaluate", parents=[processes], help="measure an exported model on fixed scenes"
    )
    evaluate.add_argument("model", type=Path, help="models/NAME/VERSION")
    evaluate.add_argument("--split", choices=("validation", "test"), default="test")
    evaluate.add_argument("--scenes", type=int, default=500, help="scenes per scenario")
    evaluate.set_defaults(run=_evaluate)

    exported = commands.add_parser(
        "export", parents=[processes], help="export a recipe's best weights and prove the export"
    )
    exported.add_argument("recipe", choices=sorted(RECIPES))
    exported.add_argument("--version", type=int, default=1)
    exported.add_argument("--models", type=Path, default=MODELS)
    exported.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    exported.set_defaults(run=_export)
    return parser


def _simulate(arguments: argparse.Namespace) -> None:
    source = Source(arguments.scenario, arguments.objects, arguments.radius)
    shards = simulate_split(source, arguments.split, arguments.scenes, arguments.workers)
    print(f"{len(shards)} shards in {shards[0].parent}")


def _calibrate(arguments: argparse.Namespace) -> None:
    print(calibration.report(arguments.scenes))


def _train(arguments: argparse.Namespace) -> None:
    recipe = RECIPES[arguments.recipe]()
    folder = runs_folder() / arguments.recipe
    initial = None if arguments.init is None else read_initial(arguments.init)
    trainer = Trainer(recipe, folder, Pace(workers=1, simulators=arguments.workers), initial)
    error = trainer.run()
    print(f"best validation error at T={recipe.trained_horizon}: {error:.3f} px, kept in {folder}")


def _evaluate(arguments: argparse.Namespace) -> None:
    manifest, predictor = load_exported(arguments.model)
    sets = evaluation_sets(
        manifest.scenarios, manifest.objects, arguments.split, arguments.scenes, arguments.workers
    )
    forecasts = with_covariance(run(predictor, sets), manifest.covariance)
    print(markdown_table(metric_rows(sets, forecasts, manifest.trained_horizon)))


def _export(arguments: argparse.Namespace) -> None:
    recipe = RECIPES[arguments.recipe]()
    best = torch.load(
        runs_folder() / arguments.recipe / BEST, map_location="cpu", weights_only=True
    )
    predictor = recipe.build()
    predictor.load_state_dict(best["weights"])

    def sets(split: Split, scenes: int) -> list[EvaluationSet]:
        return evaluation_sets(recipe.scenarios, recipe.objects, split, scenes, arguments.workers)

    folder = arguments.models / recipe.name / str(arguments.version)
    manifest = export(
        Trained(recipe, predictor, best["sequences"]),
        folder,
        arguments.version,
        sets("validation", recipe.validation_scenes),
        sets("test", arguments.scenes),
    )
    for name, error in manifest.parity.max_abs_error.items():
        tolerance = manifest.parity.tolerance[name]
        print(f"{name}: torch and ONNX differ by {error} (tolerance {tolerance})")
    print(markdown_table([row for row in manifest.metrics if row.split == "test"]))


if __name__ == "__main__":
    main()
