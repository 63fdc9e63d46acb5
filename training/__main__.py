"""``python -m training simulate | calibrate | train | evaluate | dissect | export | ...``."""

import argparse
import importlib
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType

from rollcast.manifest import MANIFEST_FILE, Manifest
from rollcast.scene import SCENARIOS
from training.cli import balls, footage
from training.common.settings import runs_folder
from training.data.clip_dataset import Clips
from training.data.shards import Source, data_folder, in_processes, make_missing, split_shards
from training.data.splits import Split
from training.engine.trainer import Trainer, TrainerConfig
from training.engine.warm_start import Initial
from training.evaluation import world_check
from training.evaluation.error_breakdown import dissected, dissection_table
from training.evaluation.evaluate import evaluation_sets, markdown_table, metric_rows, run
from training.export.export import export_run, with_covariance
from training.export.footage import export_rig
from training.export.load import initial_networks, load_exported
from training.export.ood_fit import FAMILIAR_SCENES, familiarise
from training.export.static_quantisation import NotWorthItError, quantise
from training.networks.fieldnet import FieldNet
from training.networks.recurrent import Predictor
from training.networks.vgg import VggEncoder, load_imagenet
from training.orchestration import campaign
from training.recipes import RECIPES
from training.reporting.markdown import with_results
from training.reporting.plots import draw_training
from training.reporting.results import committed
from training.studies import STUDIES
from training.studies.publish import DOCS, RESULTS, publish, publish_study
from training.studies.rows import BUDGET, StudyBudget

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
    _add_ray(simulate, "simulate on all its nodes")
    simulate.add_argument(
        "--output",
        metavar="FOLDER",
        help="path or address that fsspec knows, such as s3://bucket/folder (default: where "
        "training looks for it in ROLLCAST_RUNS)",
    )
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
        help="exported models (models/NAME/VERSION) or a run's folder to start from; the first "
        "one's encoder wins",
    )
    footage.add_options(train)
    train.add_argument(
        "--imagenet",
        type=Path,
        metavar="FILE",
        help="VGG16 trained on ImageNet (torchvision's .pth or ONNX), for the paper's preset",
    )
    train.add_argument(
        "--validate-every", type=int, default=TrainerConfig.validate_every, metavar="BATCHES"
    )
    _add_ray(train, "train in several processes that share every batch")
    train.add_argument("--processes", type=int, default=2, help="how many (with --ray)")
    train.set_defaults(run=_train)

    footage.add(commands, _show_lines)

    curve = commands.add_parser("curve", help="draw the loss and the validation errors of a run")
    curve.add_argument("recipe", choices=sorted(RECIPES))
    curve.add_argument("picture", type=Path, help="PNG file to write")
    curve.set_defaults(run=_curve)

    evaluate = commands.add_parser(
        "evaluate", parents=[processes], help="measure exported models on fixed scenes"
    )
    case = evaluate.add_mutually_exclusive_group(required=True)
    case.add_argument("model", type=Path, nargs="?", help="models/NAME/VERSION")
    case.add_argument(
        "--all", action="store_true", help="every committed model, into docs/results (test split)"
    )
    evaluate.add_argument("--split", choices=("validation", "test"), default="test")
    evaluate.add_argument("--scenes", type=int, default=500, help="scenes per scenario")
    evaluate.set_defaults(run=_evaluate)

    dissect = commands.add_parser(
        "dissect",
        parents=[processes],
        help="take the validation error of a fieldnet apart: parts of its state from the truth",
    )
    dissect.add_argument("model", type=Path, help="models/NAME/VERSION")
    dissect.add_argument("--scenes", type=int, default=100, help="scenes per scenario")
    dissect.set_defaults(run=_dissect)

    exported = commands.add_parser(
        "export", parents=[processes], help="export a recipe's best networks and prove the exports"
    )
    exported.add_argument("recipe", choices=sorted(RECIPES))
    exported.add_argument("--version", type=int, default=1)
    exported.add_argument("--models", type=Path, default=MODELS)
    exported.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    footage.add_options(exported)
    exported.add_argument("--name", help="of a model for clips (default: the recipe's)")
    exported.set_defaults(run=_export)

    balls.add_commands(commands, processes, MODELS)

    quantised = commands.add_parser(
        "quantise",
        parents=[processes],
        help="write another version of an exported model, faster in 8 bits, if it is worth it",
    )
    quantised.add_argument("model", type=Path, help="models/NAME/VERSION")
    quantised.add_argument("--version", type=int, default=2)
    quantised.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    quantised.set_defaults(run=_quantise)

    familiarised = commands.add_parser(
        "familiarise",
        parents=[processes],
        help="write into exported models how to tell frames that look unlike the training's",
    )
    familiarised.add_argument(
        "models", type=Path, nargs="*", help="models/NAME/VERSION (default: all committed ones)"
    )
    familiarised.add_argument(
        "--scenes", type=int, default=FAMILIAR_SCENES, help="scenes to fit to, a kind"
    )
    familiarised.set_defaults(run=_familiarise)

    campaigned = commands.add_parser(
        "campaign",
        parents=[processes],
        help="train every family in rounds and export what got better, until nothing gains",
    )
    campaigned.add_argument(
        "--sequences", type=int, default=200_000, help="training sequences of a round"
    )
    campaigned.add_argument("--scenes", type=int, default=500, help="test scenes per scenario")
    _add_ray(campaigned, "train rounds that do not need each other side by side")
    campaigned.set_defaults(run=_campaign)

    studied = commands.add_parser(
        "study",
        parents=[processes],
        help="train and measure the rows that a study's table lacks, into docs/results",
    )
    studied.add_argument("study", choices=sorted(STUDIES))
    studied.add_argument("--rows", nargs="+", default=[], metavar="METHOD", help="these rows alone")
    studied.add_argument("--scenes", type=int, default=500, help="test scenes of every case")
    studied.add_argument(
        "--sequences",
        type=int,
        default=BUDGET,
        help="training sequences of each kind of scene for every row that learns",
    )
    studied.set_defaults(run=_study)

    reported = commands.add_parser(
        "report", help="write the README's table and the studies' pages from what was measured"
    )
    reported.set_defaults(run=_report)
    return parser


def _add_ray(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument(
        "--ray",
        metavar="ADDRESS",
        help=f'{what}: address of a Ray cluster, "auto" for the one that runs on this machine or '
        '"local" for one that ends with the work (needs the extra ray-training)',
    )


def _with_ray() -> ModuleType:
    """Import what needs Ray, which is an extra."""
    try:
        return importlib.import_module("training.orchestration.ray_backend")
    except ModuleNotFoundError as error:
        raise SystemExit(
            f"--ray needs the extra ray-training ({error}); `tools/environment.sh cluster --torch` "
            "makes .venv/cluster, which has it"
        ) from error


def _address(text: str) -> str:
    """Make a path absolute, for processes that run elsewhere; other addresses stay as they are."""
    return text if "://" in text else str(Path(text).resolve())


def _simulate(arguments: argparse.Namespace) -> None:
    source = Source(arguments.scenario, arguments.objects, arguments.radius)
    folder = _address(arguments.output or str(data_folder(source, arguments.split)))
    shards = split_shards(source, arguments.split, arguments.scenes, folder)
    if arguments.ray is None:
        make = in_processes(arguments.workers)
    else:
        make = _with_ray().on_ray(arguments.ray)
    make_missing(shards, make, f"{source.name} {arguments.split}")
    print(f"{len(shards)} shards in {folder}")


def _calibrate(arguments: argparse.Namespace) -> None:
    print(world_check.report(arguments.scenes))


def _train(arguments: argparse.Namespace) -> None:
    folder = runs_folder() / arguments.recipe
    initial = [one for start in arguments.init for one in initial_networks(start)]
    config = TrainerConfig(arguments.validate_every, simulators=arguments.workers)
    imagenet = arguments.imagenet and arguments.imagenet.resolve()
    clips = footage.clips_of(arguments)
    run = partial(_run_training, arguments.recipe, folder, config, initial, imagenet, clips)
    if arguments.ray is None:
        error = run()
    else:
        error = _with_ray().train_together(arguments.ray, arguments.processes, folder, run)
    print(f"best mean validation error: {error:.3f} px, kept in {folder}")


def _run_training(
    name: str,
    folder: Path,
    config: TrainerConfig,
    initial: Sequence[Initial],
    imagenet: Path | None,
    clips: Mapping[Split, Clips] | None,
) -> float:
    recipe = RECIPES[name]()
    trainer = Trainer(recipe, folder, config, initial, clips)
    if imagenet is not None:
        network = next(iter(trainer.family.networks().values()))
        if not (isinstance(network, Predictor) and isinstance(network.encoder, VggEncoder)):
            raise SystemExit(f"--imagenet is for the paper's preset; {name} has another")
        print(f"{load_imagenet(network.encoder, imagenet)} convolutions from ImageNet")
    return trainer.run()


def _show_lines(lines: Iterable[str]) -> None:
    for line in lines:
        print(line, flush=True)


def _curve(arguments: argparse.Namespace) -> None:
    draw_training(runs_folder() / arguments.recipe, arguments.picture)


def _evaluate(arguments: argparse.Namespace) -> None:
    if arguments.all:
        if arguments.split != "test":
            raise SystemExit(f"--all measures the test split, not --split {arguments.split}")
        results = publish(MODELS, DOCS, arguments.scenes, arguments.workers)
        print(f"{len(results.cells)} figures in {DOCS / 'results.md'}")
        return
    manifest, predictor = load_exported(arguments.model)
    sets = evaluation_sets(
        manifest.simulated,
        manifest.objects,
        manifest.final_step,
        arguments.split,
        arguments.scenes,
        arguments.workers,
    )
    forecasts = with_covariance(run(predictor, sets), manifest.covariance)
    print(markdown_table(metric_rows(sets, forecasts, manifest.trained_horizon)))


def _dissect(arguments: argparse.Namespace) -> None:
    manifest, network = load_exported(arguments.model)
    if not isinstance(network, FieldNet):
        raise SystemExit(
            f"{manifest.label} is a {manifest.variant}; only a fieldnet's state has parts"
        )
    errors = {
        scenario: dissected(
            network, Source(scenario, manifest.objects), arguments.scenes, arguments.workers
        )
        for scenario in manifest.simulated
    }
    print(dissection_table(errors, manifest.objects))


def _export(arguments: argparse.Namespace) -> None:
    recipe, folder = RECIPES[arguments.recipe](), runs_folder() / arguments.recipe
    clips = footage.clips_of(arguments)
    try:
        if clips is None:
            manifests = export_run(
                recipe,
                folder,
                arguments.models,
                arguments.version,
                arguments.scenes,
                arguments.workers,
            )
        else:
            name = arguments.name or recipe.members[0].name
            made = export_rig(recipe, folder, clips, arguments.models, name, arguments.version)
            _show([made])
            return
    except FileNotFoundError as error:
        raise SystemExit(
            f"no trained weights at {error.filename}: run `python -m training train "
            f"{arguments.recipe}` first, or name the folder of its runs with ROLLCAST_RUNS"
        ) from error
    _complete(manifests, arguments.models, arguments.workers)


def _complete(manifests: Sequence[Manifest], models: Path, workers: int) -> None:
    """Write into exports what only scenes tell, and print how good they are."""
    folders = [models / manifest.name / str(manifest.version) for manifest in manifests]
    familiarise(folders, FAMILIAR_SCENES, workers)
    _show(manifests)


def _show(manifests: Sequence[Manifest]) -> None:
    """Print how exports were proved and how well they do on the test split."""
    for manifest in manifests:
        print(f"## {manifest.label}\n")
        for output, error in manifest.parity.max_abs_error.items():
            tolerance = manifest.parity.tolerance[output]
            print(f"{output}: torch and ONNX differ by {error} (tolerance {tolerance})")
        print(f"\n{markdown_table([row for row in manifest.metrics if row.split == 'test'])}\n")


def _quantise(arguments: argparse.Namespace) -> None:
    try:
        manifest = quantise(arguments.model, arguments.version, arguments.scenes, arguments.workers)
    except NotWorthItError as error:
        raise SystemExit(str(error)) from error
    print(f"{manifest.label}, from {manifest.training['quantised']}")


def _familiarise(arguments: argparse.Namespace) -> None:
    folders = arguments.models or [path.parent for path in MODELS.glob(f"*/*/{MANIFEST_FILE}")]
    for manifest in familiarise(folders, arguments.scenes, arguments.workers):
        print(f"{manifest.label}: {manifest.unfamiliar}")


def _campaign(arguments: argparse.Namespace) -> None:
    folder = runs_folder() / "campaign"
    train = partial(
        campaign.train, models=MODELS.resolve(), config=TrainerConfig(simulators=arguments.workers)
    )
    while rounds := campaign.next_rounds(campaign.lines(), folder, MODELS, arguments.sequences):
        if arguments.ray is None:
            rounds = rounds[:1]
        for chosen in rounds:
            budget = chosen.recipe.sequences
            print(f"{chosen.recipe.name}, round {chosen.number}: {budget} sequences")
        if arguments.ray is None:
            outcomes = [train(chosen) for chosen in rounds]
        else:
            outcomes = _with_ray().train_rounds(arguments.ray, folder, rounds, train)
        for chosen, outcome in zip(rounds, outcomes, strict=True):
            _finish(chosen, outcome, arguments)
    print("no family gains enough any more")


def _finish(chosen: campaign.Round, outcome: campaign.Outcome, given: argparse.Namespace) -> None:
    """Export what a round made better, and write down that it is done."""
    before, now = outcome.error_before_px, outcome.error_px
    print(f"{chosen.recipe.name}: {before} px before, {now} px now")
    if outcome.gain > 0:
        made = export_run(chosen.recipe, chosen.folder, MODELS, 1, given.scenes, given.workers)
        _complete(made, MODELS, given.workers)
    campaign.finish(chosen, outcome)


def _study(arguments: argparse.Namespace) -> None:
    study = STUDIES[arguments.study]
    file = DOCS / "results" / RESULTS
    budget = StudyBudget(arguments.workers, arguments.sequences)
    try:
        for done in study.run(file, arguments.scenes, budget, arguments.rows):
            print(done, flush=True)
            publish_study(study, DOCS)
    except ValueError as error:
        raise SystemExit(str(error)) from error


def _report(_: argparse.Namespace) -> None:
    manifests = [Manifest.read(folder / MANIFEST_FILE) for folder in committed(MODELS)]
    text = README.read_text(encoding="utf-8")
    README.write_text(with_results(text, manifests), encoding="utf-8")
    for study in STUDIES.values():
        publish_study(study, DOCS)


if __name__ == "__main__":
    main()
