"""``rollcast predict``: where the ball of a video or of images goes."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from rollcast.client.calls import ForecastOptions
from rollcast.client.clips import (
    blend_warnings,
    crop_warnings,
    named_model,
    sends_whole,
    setup_crop,
    told_rates,
)
from rollcast.client.prompts import moved
from rollcast.commands.options import (
    Balls,
    Crop,
    Drawing,
    Outcome,
    Printed,
    Rate,
    Slowdown,
    Start,
    Stride,
    Url,
    client,
    positive_rate,
    whole_number,
)
from rollcast.commands.overlay import draw
from rollcast.commands.printing import ball_warnings, forecast_text
from rollcast.commands.progress import stage, waiting
from rollcast.commands.reading import frame_of_step, read
from rollcast.footage import WholePicture
from rollcast.scene import MAX_BALLS, Domain
from rollcast.schemas import AUTO_MODEL, DEFAULT_HORIZON, MAX_HORIZON
from rollcast.trajectory import FRAME_RATE_HZ

HELP = """\
Forecast balls in a video or in images.

Reads four frames, requests a forecast from a running service, prints the path and, with --out,
draws it over the footage. A model for any number of balls (any-ball) is sent whole pictures, and
rings show where it saw the balls.

\b
Examples:
  rollcast predict clip.mp4 --start 2.0 --crop 100,0,480 --out overlay.png
  rollcast predict clip.mp4 --ball 412,230 --ball 105,88 --out rings.png
  rollcast predict clip.mp4 --stride 3 --out overlay.mp4 --slowdown 4
  rollcast predict frames/ --rate 120 --stride 3 --format csv > forecast.csv
  rollcast predict clip.mp4 --final 39 --out between.png
"""


def predict(
    context: typer.Context,
    footage: Annotated[
        list[Path],
        typer.Argument(
            metavar="VIDEO|FOLDER|IMAGES",
            help=f"a video, from which four frames are read, at {FRAME_RATE_HZ} per second or at "
            "the model's rate (interpolated where the camera has none); or a folder of images, or "
            "at least four images",
            show_default=False,
        ),
    ],
    start: Start = None,
    stride: Stride = None,
    rate: Rate = None,
    crop: Crop = None,
    final: Annotated[
        int | None,
        typer.Option(
            parser=whole_number(1, MAX_HORIZON - 1),
            metavar="STEP",
            help="give the model the frame of this step too, to interpolate the path: 39 with "
            "one ball, 29 with two or three",
        ),
    ] = None,
    horizon: Annotated[
        int | None,
        typer.Option(
            parser=whole_number(1, MAX_HORIZON),
            metavar="STEPS",
            help="number of steps to forecast, at the frame rate (default: {DEFAULT_HORIZON}; "
            "with --final up to that frame)",
            show_default=False,
        ),
    ] = None,
    step_rate: Annotated[
        float | None,
        typer.Option(
            parser=positive_rate,
            metavar="HZ",
            help="steps of the forecast per second (default: the frame rate)",
        ),
    ] = None,
    model: Annotated[
        str, typer.Option(metavar="NAME", help="auto, NAME or NAME@VERSION")
    ] = AUTO_MODEL,
    num_objects: Annotated[
        int | None,
        typer.Option(
            parser=whole_number(1, MAX_BALLS),
            metavar="BALLS",
            help="number of balls (default: the model's, 1 with auto; models for any number of "
            "balls forecast the moving ones)",
        ),
    ] = None,
    ball: Balls = None,
    scenario: Annotated[
        Domain | None, typer.Option(help="restrict auto to models for this scenario")
    ] = None,
    url: Url = None,
    form: Printed = "table",
    out: Drawing = None,
    slowdown: Slowdown = 1,
) -> Outcome:
    """Read frames, request a forecast, print and draw it."""
    if horizon is None:
        horizon = DEFAULT_HORIZON if final is None else final + 1
    stages = 2 if out is None else 3
    asked = ForecastOptions(model=model, balls=ball, scenario=scenario)
    name = named_model(asked)
    with client(context, url) as service:
        with waiting(stage(1, stages, "reading the footage")):
            models = service.models() if name is None else [service.model(*name)]
            known = None if name is None else models[0]
            known_rate = (known and known.frame_rate_hz) or FRAME_RATE_HZ
            whole = sends_whole(models, asked, final_frame=final is not None)
            part = crop or (WholePicture() if whole else setup_crop(known))
            told = told_rates(models) if final is None else None
            observed, later_frames = read(footage, start, stride, rate, part, known_rate, told)
            final_frame = None if final is None else frame_of_step(final, observed, later_frames)
        with waiting(stage(2, stages, "waiting for the forecast")):
            forecast = service.predict(
                list(observed.frames),
                final_frame=final_frame,
                horizon=horizon,
                model=model,
                num_objects=num_objects,
                balls=moved(ball, observed.crop) if ball else None,
                scenario=scenario,
                frame_rate=observed.frame_rate,
                step_rate=step_rate,
            )
    warnings = [
        *blend_warnings(observed, known_rate),
        *crop_warnings(observed, chosen=part is not None),
        *observed.warnings,
        *forecast.warnings,
        *ball_warnings(forecast),
    ]
    text = forecast_text(observed, forecast, warnings, form)
    said = stage(3, stages, "drawing")
    drawing = (
        None
        if out is None
        else partial(draw, out, observed, later_frames, forecast, slowdown, said)
    )
    return Outcome(text, warnings if form == "csv" else (), finish=drawing)
