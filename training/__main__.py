"""``python -m training simulate | calibrate | train | evaluate | export | report``."""

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
from training.report import committed, with_results
from training.settings import runs_folder
from training.simulate import Source, simulate_split
from training.splits import Split
from training.trainer import BEST, Pace, Trainer

MODELS = Path("models")
README = Path("README.md")


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
        "--init",
        type=Path,
        nargs="+",
        default=[],
        metavar="MODEL",
        help="exported models (models/NAME/VERSION) to start from; the first one's encoder wins",
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
        "export", parents=[processes], help="export a recipe's best networks and prove the exports"
    )
    exported.add_argument("recipe", choices=sorted(RECIPES))
    exported.add_argument("--version", type=int, default=1)
    exported.add_argument("--models", type=Path, default=MODELS)
    exported.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    exported.set_defaults(run=_export)

    reported = commands.add_parser(
        "report", help="write the README's table of results from the committed models"
    )
    reported.set_defaults(run=_report)
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
    initial = [read_initial(folder) for folder in arguments.init]
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
    weights = runs_folder() / arguments.recipe / BEST
    if not weights.exists():
        raise SystemExit(
            f"no trained weights at {weights}: run `python -m training train {arguments.recipe}` "
            "first, or name the folder of its runs with ROLLCAST_RUNS"
        )
    best = torch.load(weights, map_location="cpu", weights_only=True)

    def sets(split: Split, scenes: int) -> list[EvaluationSet]:
        return evaluation_sets(recipe.scenarios, recipe.objects, split, scenes, arguments.workers)

    validation, test = sets("validation", recipe.validation_scenes), sets("test", arguments.scenes)
    for name, predictor in recipe.build().predictors().items():
        predictor.load_state_dict(best["weights"][name])
        manifest = export(
            Trained(recipe, name, predictor, best["sequences"]),
            arguments.models / name / str(arguments.version),
            arguments.version,
            validation,
            test,
        )
        print(f"## {manifest.label}\n")
        for output, error in manifest.parity.max_abs_error.items():
            tolerance = manifest.parity.tolerance[output]
            print(f"{output}: torch and ONNX differ by {error} (tolerance {tolerance})")
        print(f"\n{markdown_table([row for row in manifest.metrics if row.split == 'test'])}\n")


def _report(_: argparse.Namespace) -> None:
    text = README.read_text(encoding="utf-8")
    README.write_text(with_results(text, committed(MODELS)), encoding="utf-8")


if __name__ == "__main__":
    main()
