"""The page of real footage: tracks, networks and figures of clips that are no part of the project.

Clips of an arena with four balls, and of a pool table (``docs/results/real.md`` says whose). One
command tracks them, trains on them and measures, and does nothing twice: all of it is kept beside
the runs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from rollcast.markdown import table
from rollcast.tracking.quality import Quality
from rollcast.tracking.track import track
from training.common.settings import runs_folder
from training.data.clip_dataset import SETUP_FILE, Clip, Clips, Setup, load_clips
from training.data.splits import Split
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.export.graph_finder import GraphFinder
from training.export.load import initial_networks, load_exported
from training.networks.recurrent import Family
from training.objectives.metrics import forecast
from training.recipes.recipe import Milestone, Recipe
from training.recipes.setup import T_TRAIN, setup, setup_continued, setup_seeing
from training.reporting.footage_report import Measured, SetupClips, markdown, measure, rows_of

BEGIN, END = "<!-- made by `python -m training real` -->", "<!-- end of it -->"
"""Marks around the measured part of the page."""
MODELS = Path(__file__).parents[2] / "models"
ONE_BALL, SEVERAL_BALLS = MODELS / "fieldnet" / "1", MODELS / "fieldnet-3" / "1"
"""Models from simulated scenes."""
PERCEPTION = MODELS / "any-ball" / "1"
"""Model that tracks the clips."""
STAGES = {1: (setup, setup_continued), 4: (setup, setup_seeing, setup_continued)}
"""Consecutive trainings on the arena by number of balls: four similar balls require a training of
the perception."""
SEEING = ("vin", "v-lstm")
"""Baselines that take hours with four balls: V-LSTM has a network for each."""
VALIDATE_EVERY = 125
FEW = 6_400
"""Training sequences where there is but one clip to learn from."""


@dataclass(frozen=True)
class FootageSource:
    """Clips of one set-up.

    Attributes
    ----------
    name
        Of its folder beside the runs.
    clips
        Files with their titles on the page.
    """

    name: str
    clips: Mapping[str, str]
    balls: int
    setup: Setup

    @property
    def folder(self) -> Path:
        """Clips and tracks as training reads them."""
        return runs_folder() / "real" / self.name


@dataclass(frozen=True)
class Shot:
    """The white ball of a pool clip while nothing but balls and table touches it.

    Attributes
    ----------
    ball
        Its number among the clip's.
    first, last
        Frames: after the cue has let go of it, and before it rests or is lost.
    """

    filmed: FootageSource
    ball: int
    first: int
    last: int

    @property
    def title(self) -> str:
        """Title on the page."""
        (title,) = self.filmed.clips.values()
        return title

    def clip(self) -> Clip:
        """Return that part of the clip."""
        (whole,) = load_clips(self.filmed.folder)["test"]
        part = slice(self.first, self.last + 1)
        return replace(
            whole,
            frames=whole.frames[part],
            positions=whole.positions[:, part],
            missed=whole.missed[part],
        )


ARENA = FootageSource(
    "arena",
    {f"4Ball-short{number}.mp4": f"arena {number}" for number in (1, 3, 4, 5)},
    4,
    Setup(crop=(125, 0, 480), splits={"validation": ("4Ball-short5",), "test": ("4Ball-short1",)}),
)


def _pool(stem: str, title: str, balls: int) -> FootageSource:
    setup = Setup(crop=(280, 0, 720), splits={"test": (stem,)})
    return FootageSource(stem, {f"{stem}.mp4": title}, balls, setup)


POOL = (
    _pool("gleitreibungskoeffizient_0125_0132", "pool, a ball slides and rolls to rest", 1),
    _pool("null_grad_stoss_1_0003_0009", "pool, one ball hits another", 2),
    _pool("simulation_vs_reality_1_0008_0011", "pool, a ball is pocketed", 2),
)
SHOTS = (Shot(POOL[0], 0, 18, 178), Shot(POOL[1], 1, 27, 49))
"""The third clip's white ball moves for six frames: no forecast fits in."""


def make(source: Path, page: Path, baselines: Sequence[str]) -> Iterator[str]:
    """Run missing tracking, training and measurements and write the page; yield progress.

    Parameters
    ----------
    source
        Folder of the clips.
    page
        Markdown with the marks BEGIN and END.
    baselines
        Of the arena's tables.
    """
    reports: list[tuple[str, Quality]] = []
    for filmed in (ARENA, *POOL):
        reports += zip(filmed.clips.values(), tracked(source, filmed), strict=True)
        yield f"{filmed.name}: tracked in {filmed.folder}"
    parts = ["## Tracking", tracking_table(reports)]
    for objects, title in ((1, "the red ball, one among four"), (4, "all four balls")):
        of_arena, rows = arena(objects, baselines)
        parts += [f"## Arena: {title}", markdown(rows, of_arena)]
        yield f"arena, {title}: measured"
    for shot in SHOTS:
        of_pool, rows = left_out(shot, [other for other in SHOTS if other is not shot])
        parts += [f"## {shot.title.capitalize()}", markdown(rows, of_pool)]
        yield f"{shot.title}: measured"
    text = page.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    page.write_text("\n\n".join([before + BEGIN, *parts, END + after]), encoding="utf-8")


def tracked(source: Path, filmed: FootageSource) -> list[Quality]:
    """Track the clips of a set-up into its folder, unless all are; return the report on each.

    The balls of all clips are in the order of the first one's, so they are tracked in one go.
    """
    folder = filmed.folder
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SETUP_FILE).write_text(filmed.setup.model_dump_json(exclude_none=True))
    clips = [folder / file for file in filmed.clips]
    reports = [clip.with_suffix(".json") for clip in clips]
    for clip in clips:
        clip.unlink(missing_ok=True)
        clip.symlink_to((source / clip.name).resolve())
    if not all(report.exists() for report in reports):
        palettes, finder = None, GraphFinder(PERCEPTION)
        for clip, report in zip(clips, reports, strict=True):
            tracks, quality, found = track(clip, finder, balls=filmed.balls, like=palettes)
            palettes = found if palettes is None else palettes
            tracks.write(clip.with_suffix(".parquet"))
            report.write_text(quality.model_dump_json())
    return [Quality.model_validate_json(report.read_bytes()) for report in reports]


def tracking_table(reports: Sequence[tuple[str, Quality]]) -> str:
    """Make the table of the reports."""
    return table(
        ("clip", "frames", "balls found", "gaps", "jumps", "suspected swaps"),
        [
            (
                title,
                f"{one.frames:,}",
                f"{100 * one.found:.1f} %",
                len(one.gaps),
                len(one.jumps),
                len(one.suspected_swaps),
            )
            for title, one in reports
        ],
    )


def arena(objects: int, baselines: Sequence[str]) -> tuple[SetupClips, list[Measured]]:
    """Measure baselines and networks on the arena's first ball, or on all of them."""
    balls = None if objects == ARENA.balls else list(range(objects))
    clips: dict[Split, Clips] = {
        split: Clips(some, balls) for split, some in load_clips(ARENA.folder).items()
    }
    recipes = [stage(objects) for stage in STAGES[objects]]
    begin = ONE_BALL if objects == 1 else SEVERAL_BALLS
    for recipe in recipes:
        begin = trained(recipe, clips, begin)
    of_arena = SetupClips(clips)
    chosen = [name for name in baselines if objects == 1 or name not in SEEING]
    return of_arena, list(measure(of_arena, chosen, recipes))


def left_out(shot: Shot, others: Sequence[Shot]) -> tuple[SetupClips, list[Measured]]:
    """Measure a pool clip that training did not see, on every window up to T_TRAIN."""
    known = Clips([_alone(other) for other in others])
    clips: dict[Split, Clips] = {
        "training": known, "validation": known, "test": Clips([_alone(shot)])
    }  # fmt: skip
    recipe = of_one_clip(f"without-{shot.filmed.name}")
    trained(recipe, clips, ONE_BALL)
    of_pool = SetupClips(clips, T_TRAIN, every=1)
    _, network = load_exported(ONE_BALL)
    untaught = forecast(
        Family({"it": network}), of_pool.windows("test"), T_TRAIN, torch.device("cpu")
    )["it"]
    return of_pool, [
        *measure(of_pool, ("constant position", "linear", "quadratic"), []),
        *rows_of("fieldnet@1, trained in simulation only", untaught, of_pool.moments),
        *measure(of_pool, (), [recipe]),
    ]


def of_one_clip(name: str) -> Recipe:
    """Return a short fine-tuning up to T_TRAIN of a network for one ball."""
    recipe = setup(1)
    assert recipe.explicit is not None
    horizons = (Milestone(0, 1), Milestone(0.3, 2), Milestone(0.8, T_TRAIN))
    return replace(
        recipe,
        name=name,
        sequences=FEW,
        curriculum=horizons,
        explicit=replace(recipe.explicit, curriculum=horizons),
    )


def _alone(shot: Shot) -> Clip:
    """Return a shot's clip with the white ball's track alone."""
    clip = shot.clip()
    ball = slice(shot.ball, shot.ball + 1)
    return replace(clip, positions=clip.positions[ball], colors=clip.colors[ball])


def trained(recipe: Recipe, clips: Mapping[Split, Clips], begin: Path) -> Path:
    """Train a recipe unless that has been done; return the folder of its run."""
    folder = runs_folder() / recipe.name
    Trainer(recipe, folder, TrainerConfig(VALIDATE_EVERY), initial_networks(begin), clips).run()
    return folder
