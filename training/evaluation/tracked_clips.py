"""Measures ``rollcast track`` on clips whose balls have been tracked by hand.

    python -m training tracked-clips http://127.0.0.1:8000 PID CLIPS TRACKS

CLIPS and TRACKS are those of :mod:`training.evaluation.real_clips`. The command runs as its users
run it, in a process of its own for every clip, against a service that runs as process PID.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rollcast.markdown import header, row
from rollcast.tracking.quality import Quality
from rollcast.tracking.tracks import Tracks
from training.evaluation.real_clips import hand_tracks

HEAD = (
    "clip", "frames", "repeated", "balls", "found, %", "by hand: ball", "within a radius, %",
    "switches", "processor s per s", "of these the service", "MiB",
)  # fmt: skip
SUFFIXES = {".mp4", ".webm", ".mov", ".mkv", ".avi"}
MIB = 2**20


@dataclass(frozen=True)
class Run:
    """One clip, tracked."""

    tracks: Tracks
    quality: Quality
    client_cpu_s: float
    service_cpu_s: float
    peak_memory_mib: float
    """Peak memory of the command; that of the service does not depend on the clip."""


@dataclass(frozen=True)
class Followed:
    """A ball that was tracked by hand, in the tracks of the command."""

    share: float
    """Share of its frames in which some track is within its radius."""
    switches: int
    """Number of changes of the nearest track."""
    frames: int


def run(url: str, service: int, clip: Path) -> Run | str:
    """Track a clip; return a message if the command fails.

    Parameters
    ----------
    service
        Id of the service's process, which runs on this machine.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "rollcast", "track", str(clip.resolve())]
        before_s = _cpu_s(service)
        process = subprocess.Popen(
            [*command, "--url", url, "--out", folder, "--no-video"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stderr is not None
        said = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            return said.strip()
        made = Path(folder) / clip.stem
        return Run(
            Tracks.read(made.with_name(f"{made.name}.parquet")),
            Quality.model_validate_json(made.with_name(f"{made.name}.json").read_bytes()),
            usage.ru_utime + usage.ru_stime,
            _cpu_s(service) - before_s,
            usage.ru_maxrss * 1024 / MIB,
        )


def followed(tracks: Tracks, path: Mapping[int, tuple[float, float]], radius_px: float) -> Followed:
    """Compare tracks with a ball that was tracked by hand.

    A frame that repeats an earlier one shows the balls where they were in that one.

    Parameters
    ----------
    path
        Its centre by frame, pixels of the clip.
    """
    owners: list[int] = []
    for frame, place in sorted(path.items()):
        shown = max(0, int(np.searchsorted(tracks.frames, frame, side="right")) - 1)
        apart: Float[np.ndarray, " balls"] = np.linalg.norm(
            tracks.positions_px[shown] - np.array(place), axis=-1
        )
        apart = np.where(np.isnan(apart), np.inf, apart)
        owners.append(int(apart.argmin()) if apart.min() <= radius_px else -1)
    seen = [owner for owner in owners if owner >= 0]
    switches = sum(one != other for one, other in pairwise(seen))
    return Followed(len(seen) / len(owners), switches, len(owners))


def table(url: str, service: int, clips: Path, tracks: Path) -> Iterator[str]:
    """Lines of a table, one for every clip and ball that was tracked by hand."""
    setups: dict[str, Any] = json.loads((tracks / "setup.json").read_text(encoding="utf-8"))
    named = {setup["file"]: setup.get("tracks", name) for name, setup in setups.items()}
    yield header(HEAD)
    for clip in sorted(clips.iterdir()):
        if clip.suffix.lower() not in SUFFIXES:
            continue
        made = run(url, service, clip)
        if isinstance(made, str):
            yield row([clip.name, made, *[""] * (len(HEAD) - 2)])
            continue
        quality = made.quality
        start = [
            clip.stem, quality.frames, quality.repeated, len(quality.balls),
            f"{100 * quality.found:.0f}",
        ]  # fmt: skip
        seconds = quality.seconds
        cpu = made.client_cpu_s + made.service_cpu_s
        end = [
            f"{cpu / seconds:.2f}", f"{made.service_cpu_s / seconds:.2f}",
            f"{made.peak_memory_mib:.0f}",
        ]  # fmt: skip
        if clip.name not in named:
            yield row([*start, "-", "-", "-", *end])
            continue
        paths, radii = hand_tracks(tracks / f"{named[clip.name]}.csv")
        for ball, path in paths.items():
            it = followed(made.tracks, path, radii[ball])
            yield row([*start, ball, f"{100 * it.share:.1f}", it.switches, *end])
            start, end = [""] * len(start), [""] * len(end)


def _cpu_s(process: int) -> float:
    """Return the processor time of a process, seconds."""
    stat = Path(f"/proc/{process}/stat").read_text(encoding="ascii")
    user, system = stat.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
