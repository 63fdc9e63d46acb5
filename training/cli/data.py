"""Commands about simulated scenes."""

from pathlib import Path
from typing import Annotated

import typer

from rollcast import datasets
from rollcast.scene import MAX_OBJECTS, Scenario
from rollcast.simulation import Sequence
from training.cli.options import CORES, Workers, failed, ray_option, with_ray
from training.data.shards import (
    Source,
    data_folder,
    in_processes,
    load_recordings,
    make_missing,
    split_shards,
)
from training.data.splits import Split
from training.evaluation import world_check


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("simulate")(simulate)
    app.command("check-world")(check_world)


def simulate(
    scenario: Annotated[Scenario, typer.Argument()],
    num_objects: Annotated[int, typer.Option(min=1, max=MAX_OBJECTS, help="number of balls")] = 1,
    split: Annotated[Split, typer.Option()] = "training",
    scenes: Annotated[int, typer.Option(min=1)] = 1000,
    workers: Workers = CORES,
    ray: Annotated[str | None, ray_option("simulate on all its nodes")] = None,
    output: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER",
            help="path or address supported by fsspec, such as s3://bucket/folder (default: the "
            "folder in ROLLCAST_RUNS from which training reads), or FILE.parquet: a data set for "
            "rollcast.datasets",
        ),
    ] = None,
    image_size: Annotated[
        int | None,
        typer.Option(
            min=32, max=512, help="side of the frames in FILE.parquet, pixels (default: no frames)"
        ),
    ] = None,
) -> None:
    """Simulate scenes of a split; existing ones are kept."""
    source = Source(scenario, num_objects)
    file = Path(output) if output is not None and output.endswith(".parquet") else None
    if file is None and image_size is not None:
        failed("--image-size renders frames into FILE.parquet: name it with --output")
    folder = _address(output if output and not file else str(data_folder(source, split)))
    shards = split_shards(source, split, scenes, folder)
    make = in_processes(workers) if ray is None else with_ray().on_ray(ray)
    make_missing(shards, make, f"{source.name} {split}")
    if file is None:
        typer.echo(f"{len(shards)} shards in {folder}")
        return
    recordings = load_recordings([Path(shard.address) for shard in shards])[:scenes]
    count = datasets.write(
        file, (Sequence(one.scene, one.trajectory, 0) for one in recordings), image_size
    )
    typer.echo(f"{count} scenes in {file}")


def check_world(scenes: Annotated[int, typer.Option(min=1)] = 100) -> None:
    """Show how hard the simulated world is beside the paper's."""
    typer.echo(world_check.report(scenes))


def _address(text: str) -> str:
    """Make a path absolute, for processes that run elsewhere; other addresses stay as they are."""
    return text if "://" in text else str(Path(text).resolve())
