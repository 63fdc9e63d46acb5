"""``rollcast simulate``: scenes to try forecasts on, with the true path."""

from pathlib import Path
from typing import Annotated

import typer
from PIL import Image

from rollcast.client import Simulation
from rollcast.commands.options import (
    VIDEOS,
    CommandError,
    FolderOrVideo,
    Format,
    Outcome,
    Printed,
    Slowdown,
    Url,
    client,
    whole_number,
)
from rollcast.commands.printing import as_json, truth_text
from rollcast.commands.progress import counted, waiting
from rollcast.scene import MAX_OBJECTS, MAX_SEED, Scenario
from rollcast.schemas import DEFAULT_HORIZON, MAX_IMAGE_SIZE, MAX_STEPS, MIN_FRAME_SIZE, MIN_STEPS
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES
from rollcast.video_writer import write_video

HELP = """\
Simulate a scene: its frames and the true path.

Without --out the path is printed. The same seed always produces the same frames.

\b
Examples:
  rollcast simulate ellipsoid --seed 7
  rollcast simulate ellipsoid --seed 7 --out scene && rollcast predict scene
  rollcast simulate heightfield --steps 200 --size 512 --out scene.mp4 --slowdown 2
"""


def simulate(
    context: typer.Context,
    scenario: Annotated[Scenario, typer.Argument(help="kind of scene", metavar="SCENARIO")],
    seed: Annotated[
        int,
        typer.Option(parser=whole_number(0, MAX_SEED), metavar="SEED", help="seed of the scene"),
    ] = 0,
    num_objects: Annotated[
        int,
        typer.Option(parser=whole_number(1, MAX_OBJECTS), metavar="BALLS", help="number of balls"),
    ] = 1,
    steps: Annotated[
        int,
        typer.Option(
            parser=whole_number(MIN_STEPS, MAX_STEPS),
            metavar="STEPS",
            help=f"number of frames, {FRAME_RATE_HZ} per second",
        ),
    ] = OBSERVED_FRAMES + DEFAULT_HORIZON,
    size: Annotated[
        int,
        typer.Option(
            parser=whole_number(MIN_FRAME_SIZE, MAX_IMAGE_SIZE),
            metavar="PIXELS",
            help="frame width and height",
        ),
    ] = 128,
    url: Url = None,
    form: Printed = "table",
    out: FolderOrVideo = None,
    slowdown: Slowdown = 1,
) -> Outcome:
    """Request a scene; print its paths, or write paths and frames to files."""
    video = out is not None and out.suffix.lower() in VIDEOS
    if out is not None and not video and not _is_free(out):
        raise CommandError(f"{out} is not an empty folder; choose another one with --out")
    if video and size % 2:
        raise CommandError(f"--size is {size}; a video needs an even size")
    with client(context, url) as service, waiting("waiting for the service"):
        simulation = service.simulate(
            scenario,
            seed=seed,
            num_objects=num_objects,
            steps=steps,
            image_size=size,
            include_frames=out is not None,
        )
    if out is None or simulation.frames is None:
        return Outcome(truth_text(simulation, form))
    pictures = counted(map(Image.fromarray, simulation.frames), steps, "writing")
    if video:
        write_video(out, pictures, simulation.frame_rate / slowdown)
        return Outcome(f"{out}: {steps} frames")
    out.mkdir(exist_ok=True)
    for index, picture in enumerate(pictures):
        picture.save(out / f"frame{index:04}.png")
    truth = _write_truth(out, simulation, form)
    return Outcome(
        f"{out}: {steps} frames, {truth.name} and scene.json; `rollcast predict {out}` forecasts "
        "what follows the first four"
    )


def _is_free(folder: Path) -> bool:
    return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))


def _write_truth(folder: Path, simulation: Simulation, form: Format) -> Path:
    """Write the true path and the scene beside the frames."""
    (folder / "scene.json").write_text(as_json(simulation.scene.model_dump(mode="json")) + "\n")
    truth = folder / ("truth.json" if form == "json" else "truth.csv")
    truth.write_text(truth_text(simulation, "json" if form == "json" else "csv") + "\n")
    return truth
