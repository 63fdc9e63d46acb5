"""Four frames of a clip, as the client sends them; videos need the extra ``video``."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias, TypeGuard

from rollcast.client.calls import ForecastOptions, checked_rate, number
from rollcast.client.images import Frames
from rollcast.client.prompts import moved, prompts_of
from rollcast.clip import open_clip
from rollcast.errors import InvalidArgumentError
from rollcast.footage import Footage, SquareCrop, WholePicture, read_evenly
from rollcast.schemas import AUTO_MODEL, ModelEntry
from rollcast.trajectory import FRAME_RATE_HZ

Clip: TypeAlias = os.PathLike[str] | str
"""Path of a video, a folder of images or a TIFF file of several pages."""
LONG_BLEND_S = 0.05
"""Distance of two frames, in time, over which a ball may move too far for them to be blended."""


def is_clip(frames: "Frames | Clip") -> TypeGuard[Clip]:
    """Return whether frames are given as the path of one video."""
    return isinstance(frames, os.PathLike | str)


def named_model(options: ForecastOptions) -> tuple[str, int | None] | None:
    """Return name and version of the requested model, None for "auto".

    Raises
    ------
    InvalidArgumentError
        When it is no text.
    """
    model: object = options.get("model", AUTO_MODEL)
    if not isinstance(model, str):
        raise InvalidArgumentError(f"model is {model!r}, expected auto, NAME or NAME@VERSION")
    name, _, version = model.partition("@")
    return None if name == AUTO_MODEL else (name, int(version) if version.isdecimal() else None)


def read_clip(
    clip: Clip, options: ForecastOptions, models: Sequence[ModelEntry], *, final_frame: bool
) -> tuple[Frames, ForecastOptions, tuple[str, ...]]:
    """Read four frames at the rate and crop of a model.

    Parameters
    ----------
    clip
        Video, folder of images or TIFF file.
    options
        Options of the forecast: ``start_s`` and ``frame_rate`` say which frames are read,
        ``camera_hz`` how many the camera took.
    models
        The requested model, whose frame rate and crop are used; all of the service for "auto".
    final_frame
        Whether a final frame goes along; no model that reads one is told the rate.

    Returns
    -------
    tuple
        The frames, the options that remain for the service, and warnings.

    Raises
    ------
    InvalidArgumentError
        When an option cannot be used.
    MissingExtraError
        When it is a video and PyAV is not installed.
    FootageError
        When the clip cannot be read, or ends too early.
    """
    model = None if named_model(options) is None else models[0]
    asked, camera_hz = (
        None if (rate := options.get(name)) is None else checked_rate(name, rate)
        for name in ("frame_rate", "camera_hz")
    )
    rate = asked or (model and model.frame_rate_hz) or FRAME_RATE_HZ
    told = told_rates(models) if asked is None and not final_frame else None
    balls, is_cropped = options.get("balls"), options.get("crop") is not None
    whole = not is_cropped and sends_whole(models, options, final_frame=final_frame)
    crop = WholePicture() if whole else setup_crop(model)
    source = open_clip(Path(clip), rate=camera_hz, default_rate=rate)
    start_s = 0.0 if (given := options.get("start_s")) is None else number("start_s", given)
    seen = read_evenly(source, start_s=start_s, crop=crop, frame_rate=rate, told_rates=told)
    read = ForecastOptions(frame_rate=seen.frame_rate, start_s=None, crop=None, camera_hz=None)
    rest = options | read
    if balls is not None:
        rest["balls"] = moved(prompts_of(balls), seen.crop)
    # Frames of a clip are RGB; a final frame that is an array has the order that the caller names.
    frames = seen.frames[..., ::-1] if options.get("channels") == "bgr" else seen.frames
    chosen = is_cropped or crop is not None
    warnings = (*seen.warnings, *blend_warnings(seen, rate), *crop_warnings(seen, chosen=chosen))
    return frames, rest, warnings


def sends_whole(
    models: Sequence[ModelEntry], options: ForecastOptions, *, final_frame: bool
) -> bool:
    """Return whether whole pictures are sent: to a model for any number of balls.

    "auto" takes one for points that select balls, and for pictures that are not square.

    Parameters
    ----------
    models
        The requested model; all of the service for "auto".
    options
        Options of the forecast: ``model``, ``balls`` and ``scenario`` are used.
    final_frame
        Whether a final frame goes along; no such model reads one.
    """
    if options.get("balls") is not None:
        return True
    if named_model(options) is not None:
        return takes_any(models[0])
    scenario = options.get("scenario")
    return not final_frame and any(
        model.status == "ready"
        and model.default
        and takes_any(model)
        and (scenario is None or scenario in (model.scenarios or ()))
        for model in models
    )


def told_rates(models: Sequence[ModelEntry]) -> tuple[float, float] | None:
    """Return the rates of frames that one of some models is told, None if none is told them.

    Of several models, "auto" chooses among the default versions.
    """
    ready = [model for model in models if model.status == "ready"]
    known = ready if len(models) == 1 else [model for model in ready if model.default]
    return next((model.frame_rates_hz for model in known if model.frame_rates_hz), None)


def takes_any(model: ModelEntry | None) -> bool:
    """Return whether a model follows any number of balls in frames of any rectangle."""
    return model is not None and model.max_objects is not None


def setup_crop(model: ModelEntry | None) -> SquareCrop | None:
    """Return the square of the set-up that a model was trained on, if it has one."""
    return SquareCrop(*model.setup.crop) if model and model.setup else None


def crop_warnings(footage: Footage, *, chosen: bool) -> tuple[str, ...]:
    """Return a warning when the square in the middle of pictures was taken by default."""
    crop = footage.crop
    if chosen or not isinstance(crop, SquareCrop) or (crop.x, crop.y) == (0, 0):
        return ()
    return (
        f"the pictures are not square, and their middle was sent ({crop.x},{crop.y},{crop.size}): "
        "choose a crop, or a model for any number of balls, which reads whole pictures",
    )


def blend_warnings(footage: Footage, rate: float) -> tuple[str, ...]:
    """Return a warning when frames are blended that the camera did not take."""
    over_s = footage.blended_over_s
    if not over_s:
        return ()
    text = (
        f"the camera took no frames {rate:g} a second apart: they are blended from those before "
        f"and after, up to {1e3 * over_s:.0f} ms apart"
    )
    return (text if over_s <= LONG_BLEND_S else f"{text}, which is long for a rolling ball",)
