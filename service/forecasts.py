"""One prediction request answered: decode, choose, roll out, report."""

import time

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.http import (
    DEFAULT_HORIZON,
    ForecastObject,
    ModelReference,
    PredictRequest,
    PredictResponse,
    PredictTiming,
)
from rollcast.manifest import Manifest
from rollcast.scene import COLORS
from service.errors import InvalidValueError
from service.images import decode_frames
from service.registry import Registry, Wish
from service.rollout import Forecast, assemble, stacked, steps_after

RATE_TOLERANCE = 0.05
"""Relative difference of frame rates beyond which the answer carries a warning."""


def answer(request: PredictRequest, registry: Registry) -> PredictResponse:
    """Forecast what a request asks for. Takes milliseconds of processor time.

    Raises
    ------
    service.errors.ServiceError
        When the request cannot be served.
    """
    started = time.perf_counter()
    final_frame = request.final_frame is not None
    predictor = registry.choose(Wish(request.model, request.objects, request.scenario, final_frame))
    manifest = predictor.manifest
    horizon = _horizon(request, manifest)
    frames, side = _decode(request)
    decoded = time.perf_counter()
    first = predictor.encode(frames[None])
    encoded = time.perf_counter()
    outputs = stacked(steps_after(predictor, first, horizon))
    forecast = assemble(outputs, manifest.covariance).rescaled(
        side / NETWORK_FRAME_SIZE, request.frame_rate / manifest.frame_rate_hz
    )
    rolled_out = time.perf_counter()
    return PredictResponse(
        model=ModelReference(
            name=manifest.name,
            version=manifest.version,
            variant=manifest.variant,
            trained_horizon=manifest.trained_horizon,
        ),
        frame_size=(side, side),
        frame_rate=request.frame_rate,
        objects=_objects(forecast, manifest),
        times_s=[step / request.frame_rate for step in range(horizon)],
        final_positions=(
            None if forecast.final_positions is None else forecast.final_positions[0].tolist()
        ),
        warnings=_warnings(request, manifest, horizon),
        timing_ms=PredictTiming(
            decode=1e3 * (decoded - started),
            encode=1e3 * (encoded - decoded),
            rollout=1e3 * (rolled_out - encoded),
            total=1e3 * (time.perf_counter() - started),
        ),
    )


def _horizon(request: PredictRequest, manifest: Manifest) -> int:
    """Return the number of steps, which a final frame fixes."""
    if manifest.final_step is None:
        if request.final_step is not None:
            raise InvalidValueError.at("final_step", request.final_step, "a final_frame with it")
        return request.horizon or DEFAULT_HORIZON
    fixed = manifest.final_step + 1
    if request.final_step not in (None, manifest.final_step):
        expected = f"{manifest.final_step}, the step that {manifest.label} is made for"
        raise InvalidValueError.at("final_step", request.final_step, expected)
    if request.horizon not in (None, fixed):
        expected = f"{fixed}, final_step + 1 of {manifest.label}"
        raise InvalidValueError.at("horizon", request.horizon, expected)
    return fixed


def _decode(request: PredictRequest) -> tuple[np.ndarray, int]:
    fields = [f"frames[{index}]" for index in range(len(request.frames))]
    if request.final_frame is None:
        return decode_frames(request.frames, fields)
    return decode_frames([*request.frames, request.final_frame], [*fields, "final_frame"])


def _objects(forecast: Forecast, manifest: Manifest) -> list[ForecastObject]:
    turning = forecast.angular_velocities
    return [
        ForecastObject(
            id=ball,
            color=COLORS[ball],
            positions=forecast.positions[0, ball].tolist(),
            covariances=forecast.covariances[0, ball].tolist(),
            covariance_source=manifest.covariance.source,
            angular_velocities=None if turning is None else turning[0, ball].tolist(),
        )
        for ball in range(manifest.objects)
    ]


def _warnings(request: PredictRequest, manifest: Manifest, horizon: int) -> list[str]:
    warnings: list[str] = []
    if horizon > manifest.trained_horizon:
        warnings.append(
            f"The horizon of {horizon} steps exceeds the {manifest.trained_horizon} steps that "
            f"{manifest.label} was trained on: later steps are extrapolated."
        )
    known = manifest.covariance.empirical
    if known is not None and horizon > len(known):
        warnings.append(
            f"The empirical covariances of {manifest.label} end with step {len(known) - 1}: "
            "later steps repeat the last one."
        )
    rate = manifest.frame_rate_hz
    if abs(request.frame_rate - rate) > RATE_TOLERANCE * rate:
        warnings.append(
            f"The frames are {request.frame_rate:g} a second and {manifest.label} was trained on "
            f"{rate:g}: the forecast assumes what it learned there."
        )
    return warnings
