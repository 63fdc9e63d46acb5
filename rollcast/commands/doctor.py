"""``rollcast doctor``: whether everything is here that a forecast needs."""

import platform
import tempfile
from collections.abc import Iterator
from http import HTTPStatus
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import typer
from PIL import Image

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.client import Client
from rollcast.commands.options import Outcome, Url, client
from rollcast.commands.printing import as_json
from rollcast.errors import RollcastError, ServerError
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES

HELP = """\
Check Python, packages and the service, up to a forecast of a simulated ball.

Every line begins with ok, note (works with limitations) or FAIL. The exit code is 1 if anything
fails.

\b
Examples:
  rollcast doctor
  rollcast doctor --url http://robot:8000 --format json
"""
NEEDED = ("httpx2", "jaxtyping", "numpy", "pillow", "pydantic", "tenacity", "typer")
EXTRAS = {
    "video": ("av", "videos can be read and written"),
    "dataframe": ("pandas", "results become data frames"),
}
"""Extras of the package, with their packages and purpose."""
SEED = 7
HORIZON = 20
"""Horizon of the test forecast; every model was trained for at least this many steps."""
LARGEST_ERROR_PX = 10.0
"""Mean distance in 128 x 128 frames; constant position errs more than twice as much."""


class Finding(NamedTuple):
    """Result of one check."""

    verdict: Literal["ok", "note", "FAIL"]
    about: str
    message: str


def doctor(
    context: typer.Context,
    url: Url = None,
    form: Annotated[Literal["table", "json"], typer.Option("--format", help="output format")] = (
        "table"
    ),
) -> Outcome:
    """Make every check that the ones before it allow."""
    findings = [*_installed(), *_extras()]
    with client(context, url) as service:
        findings += _service(service)
    if form == "json":
        text = as_json([finding._asdict() for finding in findings])
    else:
        text = "\n".join(
            f"{finding.verdict:<5}{finding.about}: {finding.message}" for finding in findings
        )
    return Outcome(text, code=int(any(finding.verdict == "FAIL" for finding in findings)))


def _installed() -> Iterator[Finding]:
    yield Finding("ok", "python", platform.python_version())
    try:
        yield Finding("ok", "rollcast", version("rollcast"))
    except PackageNotFoundError:
        yield Finding("ok", "rollcast", "of this checkout, not installed")
    found = [f"{name} {version(name)}" for name in NEEDED]
    yield Finding("ok", "packages", ", ".join(found))


def _extras() -> Iterator[Finding]:
    for extra, (package, purpose) in EXTRAS.items():
        if find_spec(package) is None:
            yield Finding("note", extra, f"pip install 'rollcast[{extra}]', and {purpose}")
        elif extra == "video" and (fault := _video_fault()):
            message = (
                f"{package} {version(package)} fails ({fault}): pip install -U 'rollcast[video]'"
            )
            yield Finding("FAIL", extra, message)
        else:
            yield Finding("ok", extra, f"{package} {version(package)}, {purpose}")


def _video_fault() -> str | None:
    """Write a clip and read it, because an installed package may be too old."""
    try:
        from rollcast.video import read_frames
        from rollcast.video_writer import write_video

        with tempfile.TemporaryDirectory() as folder:
            clip = Path(folder) / "clip.mp4"
            write_video(clip, [Image.new("RGB", (64, 64), "gray")] * 8, FRAME_RATE_HZ)
            read_frames(clip)
    except Exception as error:  # whatever an old package raises
        return f"{type(error).__name__}: {error}"
    return None


def _service(service: Client) -> Iterator[Finding]:
    try:
        health = service.health()
        if health.status != "ready":
            hint = "; try again in some seconds" if health.status == "loading" else ""
            message = f"{service.base_url} answers, but it is not ready: {health.status}{hint}"
            yield Finding("FAIL", "service", message)
            return
        yield Finding("ok", "service", f"{service.base_url} is ready")
        yield from _models(service)
        yield from _round_trip(service)
    except RollcastError as error:
        yield Finding("FAIL", "service", f"{error}; is it running (make serve)?")


def _models(service: Client) -> Iterator[Finding]:
    entries = service.models()
    ready = [entry for entry in entries if entry.status == "ready"]
    yield Finding(
        "ok" if ready else "FAIL", "models", f"{len(ready)} of {len(entries)} can be used"
    )
    for entry in entries:
        if entry.status == "invalid":
            yield Finding("note", "models", f"{entry.name}@{entry.version}: {entry.reason}")


def _round_trip(service: Client) -> Iterator[Finding]:
    """Forecast a simulated ball and compare with where it went."""
    try:
        scene = service.simulate("hemisphere", seed=SEED, steps=OBSERVED_FRAMES + HORIZON)
    except ServerError as error:
        if error.problem.status != HTTPStatus.NOT_IMPLEMENTED:
            raise
        yield Finding("note", "simulation", error.problem.detail)
        yield _without_truth(service)
        return
    assert scene.frames is not None
    forecast = service.predict(scene.frames[:OBSERVED_FRAMES], horizon=HORIZON)
    truth = scene.positions[:, FIRST_FORECAST_FRAME:][:, :HORIZON]
    error_px = float(np.linalg.norm(forecast.positions - truth, axis=-1).mean())
    message = (
        f"a simulated ball, {HORIZON} steps with {forecast.model.name}@{forecast.model.version}: "
        f"{error_px:.1f} px off on average, in {forecast.timing_ms.total:.0f} ms"
    )
    if error_px > LARGEST_ERROR_PX:
        message = f"{message}; up to {LARGEST_ERROR_PX:g} px are expected"
        yield Finding("FAIL", "forecast", message)
    else:
        yield Finding("ok", "forecast", message)


def _without_truth(service: Client) -> Finding:
    """Forecast plain frames when no simulated truth is available."""
    frames = np.full((OBSERVED_FRAMES, NETWORK_FRAME_SIZE, NETWORK_FRAME_SIZE, 3), 128, np.uint8)
    forecast = service.predict(frames, horizon=HORIZON)
    message = (
        f"plain grey frames, {HORIZON} steps with {forecast.model.name}@{forecast.model.version}, "
        f"in {forecast.timing_ms.total:.0f} ms; the error is unknown without a simulation"
    )
    return Finding("ok", "forecast", message)
