"""``rollcast track``: where the balls of a clip are, frame by frame."""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rollcast.clip import open_clip
from rollcast.commands.options import CommandError, Crop, Outcome, Rate, Url, client, whole_number
from rollcast.commands.progress import counted, stage, waiting
from rollcast.errors import MissingExtraError
from rollcast.frames import shown_path
from rollcast.image_sequence import ImageSequence, image_files
from rollcast.scene import MAX_BALLS
from rollcast.schemas import AUTO_MODEL
from rollcast.video_writer import write_video

if TYPE_CHECKING:
    from rollcast.tracking.quality import Quality

HELP = """\
Track balls in clips from an overhead camera.

A running service finds the balls with a model for any number of balls (any-ball); no labels are
needed, and the camera must not move. Up to eight balls that move are told apart by their colours
and paths. Clips in one command belong to one set-up, and their balls have the same order. For each
clip the command writes tracks (NAME.parquet or NAME.csv), a report of possible errors (NAME.json)
and a video for review (videos/NAME.mp4). If a ball is not found, its track has a gap. Frames that
repeat the one before are left out.

\b
Examples:
  rollcast track clip.mp4
  rollcast track first.mp4 second.mp4 --balls 4 --crop 125,0,475 --out tracks
  rollcast track clip.mp4 --format csv --no-video
"""


def track(
    context: typer.Context,
    clips: Annotated[
        list[Path],
        typer.Argument(
            metavar="CLIP...",
            help="clips of one set-up: videos or folders of images",
            show_default=False,
        ),
    ],
    balls: Annotated[
        int | None,
        typer.Option(
            parser=whole_number(1, MAX_BALLS),
            metavar="BALLS",
            help="number of balls that move (default: counted automatically)",
        ),
    ] = None,
    crop: Crop = None,
    rate: Rate = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="folder for tracks, reports and videos")
    ] = Path("tracks"),
    form: Annotated[
        Literal["parquet", "csv"], typer.Option("--format", help="format of the tracks")
    ] = "parquet",
    video: Annotated[
        bool, typer.Option("--video/--no-video", help="whether to write the video for review")
    ] = True,
    model: Annotated[
        str,
        typer.Option(metavar="NAME", help="model that finds the balls: auto, NAME or NAME@VERSION"),
    ] = AUTO_MODEL,
    url: Url = None,
) -> Outcome:
    """Track every clip; write the tracks, a report and a video of each."""
    try:
        from rollcast.commands.service_finder import ServiceFinder
        from rollcast.tracking.overlay import overlaid
        from rollcast.tracking.track import track as track_clip
        from rollcast.tracking.tracks import Tracks
    except ModuleNotFoundError as error:
        raise MissingExtraError("tracking needs", error.name or "a package", "track") from error
    names = _names(clips)
    # In a folder of their own: beside the tracks training looks for the clips as they were filmed.
    videos = out / "videos"
    reports: list[Quality] = []
    warnings: list[str] = []
    palettes = None
    stages = len(names) * (2 if video else 1)
    number = 0
    for clip, name in names.items():
        source = open_clip(clip, rate=rate)
        if isinstance(source, ImageSequence) and rate is None:
            raise CommandError(
                f"{source.name} consists of images, which have no timestamps: pass their --rate"
            )
        tracks_file = beside(out / name, f".{form}")
        fingerprint = _fingerprint(clip)
        if tracks_file.exists():
            _refuse_other(tracks_file, Tracks.read(tracks_file).source_sha256, fingerprint)
        tracks_file.parent.mkdir(parents=True, exist_ok=True)
        shown = shown_path(name)
        number += 1
        said = stage(number, stages, f"tracking {shown}")
        with client(context, url) as service, waiting(said):
            finder = ServiceFinder(service, model)
            made = track_clip(source, finder, balls=balls, crop=crop, like=palettes, name=shown)
        palettes = made.palettes if palettes is None else palettes
        quality = made.quality
        replace(made.tracks, source_sha256=fingerprint).write(tracks_file)
        beside(out / name, ".json").write_text(quality.model_dump_json(indent=2) + "\n")
        if video:
            video_file = beside(videos / name, ".mp4")
            video_file.parent.mkdir(parents=True, exist_ok=True)
            number += 1
            said = stage(number, stages, f"drawing {shown}")
            pictures = counted(overlaid(source, made.tracks), quality.frames, said)
            write_video(video_file, pictures, quality.frame_rate)
        reports.append(quality)
        warnings += source.warnings
    warnings += [warning for quality in reports for warning in _quality_warnings(quality)]
    return Outcome("\n\n".join(map(_table, reports)), warnings)


def beside(path: Path, ending: str) -> Path:
    """Return a path with an ending more; names may have dots."""
    return path.with_name(path.name + ending)


def _names(clips: Sequence[Path]) -> dict[Path, str]:
    """Return a name for each clip: of those called alike the folders belong to it.

    Raises
    ------
    CommandError
        When two of one folder are called alike, or one is named twice.
    """
    stems = [_stem(clip) for clip in clips]
    names = {clip: _stem(clip) for clip in clips}
    if len(set(stems)) < len(stems):
        whole = [clip.resolve() for clip in clips]
        top = Path(os.path.commonpath([path.parent for path in whole]))
        names = {
            clip: stem if stems.count(stem) == 1 else str(path.parent.relative_to(top) / stem)
            for clip, path, stem in zip(clips, whole, stems, strict=True)
        }
    called = list(names.values())
    if len(set(called)) < len(clips):
        twice = max(called, key=called.count)
        raise CommandError(f"two clips are called {shown_path(twice)}; rename one of them")
    return names


def _stem(clip: Path) -> str:
    return clip.name if clip.is_dir() else clip.stem


def _fingerprint(clip: Path) -> str:
    """Return a hash of a file, or of the names and sizes in a folder."""
    if clip.is_dir():
        listed = [f"{path.name} {path.stat().st_size}" for path in image_files(clip)]
        text = "\n".join(listed).encode("utf-8", "surrogateescape")
        return hashlib.sha256(text).hexdigest()
    with clip.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _refuse_other(path: Path, known: str, fingerprint: str) -> None:
    """Refuse to overwrite the tracks of another clip. Older files do not name their clip."""
    if known not in ("", fingerprint):
        raise CommandError(
            f"{shown_path(path)} holds the tracks of another clip of that name; choose another "
            "folder with --out, or remove it"
        )


def _table(quality: "Quality") -> str:
    lines = [
        f"{quality.clip}: {quality.frames} frames, {quality.seconds:.1f} s, "
        f"{100 * quality.found:.1f} % of all balls found",
        "  ball  colour    found  radius px  gaps  longest",
    ]
    lines += [
        f"  {one.ball:4}  {one.color}  {100 * one.found:5.1f}  {one.radius_px:9.1f}  "
        f"{one.gaps:4}  {one.longest_gap_s:5.2f} s"
        for one in quality.balls
    ]
    return "\n".join(lines)


def _quality_warnings(quality: "Quality") -> list[str]:
    swaps = [
        f"{quality.clip}: balls {one.balls[0]} and {one.balls[1]} may be swapped after frame "
        f"{one.last}"
        for one in quality.suspected_swaps
    ]
    jumps = [
        f"{quality.clip}: ball {one.ball} jumps by {one.radii:.1f} radii in frame {one.frame}"
        for one in quality.jumps
    ]
    repeated = [
        f"{quality.clip}: {quality.repeated} of {quality.repeated + quality.frames} frames repeat "
        "the one before and were left out"
    ]
    return [*(repeated if quality.repeated else []), *swaps, *jumps]
