"""``rollcast track``: where the balls of a clip are, frame by frame."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rollcast.commands.options import CommandError, Crop, Outcome, whole_number
from rollcast.commands.progress import counted, waiting
from rollcast.errors import MissingExtraError
from rollcast.scene import MAX_FORECAST_OBJECTS
from rollcast.video_writer import write_film

if TYPE_CHECKING:
    from rollcast.tracking.quality import Quality

HELP = """\
Track the balls of clips that a camera took from above.

The camera stands still and nothing is labelled: up to four balls are found by their shape, motion
and colours. Clips that are named together are of one set-up, and their balls keep their order. For
each one the folder gets tracks (NAME.parquet), a report on what to doubt of them (NAME.json) and a
film to look at (films/NAME.mp4). Where a ball is not found its track has a gap.

\b
Examples:
  rollcast track clip.mp4
  rollcast track first.mp4 second.mp4 --balls 4 --crop 125,0,475 --out tracks
"""


def track(
    clips: Annotated[
        list[Path],
        typer.Argument(metavar="VIDEO...", help="clips of one set-up", show_default=False),
    ],
    balls: Annotated[
        int | None,
        typer.Option(
            parser=whole_number(1, MAX_FORECAST_OBJECTS),
            metavar="BALLS",
            help="how many there are (default: they are counted)",
        ),
    ] = None,
    crop: Crop = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="where tracks, reports and films go")
    ] = Path("tracks"),
) -> Outcome:
    """Track every clip; write the tracks, a report and a film of each."""
    try:
        from rollcast.tracking.overlay import overlaid
        from rollcast.tracking.track import track as track_clip
    except ModuleNotFoundError as error:
        raise MissingExtraError("tracking needs", error.name or "a package", "track") from error
    names = [clip.stem for clip in clips]
    if len(set(names)) < len(names):
        raise CommandError(f"two clips are called {max(names, key=names.count)}; name them apart")
    # In a folder of their own: beside the tracks training looks for the clips as they were filmed.
    films = out / "films"
    films.mkdir(parents=True, exist_ok=True)
    reports: list[Quality] = []
    palettes = None
    for clip in clips:
        with waiting(f"tracking {clip.name}"):
            tracks, quality, found = track_clip(clip, balls=balls, crop=crop, like=palettes)
        palettes = found if palettes is None else palettes
        tracks.write(out / f"{clip.stem}.parquet")
        (out / f"{clip.stem}.json").write_text(quality.model_dump_json(indent=2) + "\n")
        pictures = counted(overlaid(clip, tracks), quality.frames, f"drawing {clip.name}")
        write_film(films / f"{clip.stem}.mp4", pictures, quality.frame_rate)
        reports.append(quality)
    return Outcome("\n\n".join(map(_table, reports)), [w for one in reports for w in _doubts(one)])


def _table(quality: "Quality") -> str:
    lines = [
        f"{quality.clip}: {quality.frames} frames, {quality.seconds:.1f} s, "
        f"{100 * quality.found:.1f} % of all balls found",
        "  ball  colour    found  radius px  gaps  longest",
    ]
    lines += [
        f"  {one.ball:4}  {one.colour}  {100 * one.found:5.1f}  {one.radius_px:9.1f}  "
        f"{one.gaps:4}  {one.longest_gap_s:5.2f} s"
        for one in quality.balls
    ]
    return "\n".join(lines)


def _doubts(quality: "Quality") -> list[str]:
    swaps = [
        f"{quality.clip}: balls {one.balls[0]} and {one.balls[1]} may have been mistaken for each "
        f"other after frame {one.last}"
        for one in quality.suspected_swaps
    ]
    jumps = [
        f"{quality.clip}: ball {one.ball} jumps by {one.radii:.1f} radii in frame {one.frame}"
        for one in quality.jumps
    ]
    return swaps + jumps
