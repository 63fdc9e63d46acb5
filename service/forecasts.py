"""One prediction request answered, whole or step by step: decode, choose, roll out, report."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.http import (
    DEFAULT_HORIZON,
    ForecastObject,
    ForecastSummary,
    ModelReference,
    PredictRequest,
    PredictResponse,
    PredictTiming,
    StreamBall,
    StreamDone,
    StreamObject,
    StreamStep,
)
from rollcast.manifest import Manifest
from rollcast.scene import COLORS
from service.errors import InvalidValueError
from service.images import decode_frames
from service.registry import Registry, Wish
from service.rollout import (
    Forecast,
    Outputs,
    Predictor,
    Step,
    assemble,
    stacked,
    steps_after,
)
from service.waiting import Patience

RATE_TOLERANCE = 0.05
"""Relative difference of frame rates beyond which the answer carries a warning."""


def answer(request: PredictRequest, registry: Registry, patience: Patience) -> PredictResponse:
    """Forecast what a request asks for. Takes milliseconds of processor time.

    Raises
    ------
    service.errors.ServiceError
        When the request cannot be served.
    service.waiting.ClientGoneError
        When nobody waits for the answer any more.
    """
    rollout = _begin(request, registry, patience)
    outputs = stacked(rollout.steps())
    forecast = rollout.forecast(outputs, first_step=0)
    summary = rollout.summary(forecast.final_positions)
    return PredictResponse(
        **dict(summary),
        objects=_objects(forecast, rollout.predictor.manifest),
        times_s=[step / request.frame_rate for step in range(rollout.horizon)],
    )


def stream(
    request: PredictRequest, registry: Registry, patience: Patience
) -> Iterator[StreamStep | StreamDone]:
    """Forecast what a request asks for, step by step, and close with all that is no step.

    Raises
    ------
    service.errors.ServiceError
        When the request cannot be served, or not to its end.
    service.waiting.ClientGoneError
        When nobody waits for the answer any more.
    """
    rollout = _begin(request, registry, patience)
    manifest = rollout.predictor.manifest
    final = None
    for step, outputs in enumerate(rollout.steps()):
        forecast = rollout.forecast(stacked(iter([outputs])), first_step=step)
        if step == 0:
            final = forecast.final_positions
        balls = _objects(forecast, manifest)
        yield StreamStep(
            step=step,
            time_s=step / request.frame_rate,
            objects=[
                StreamObject(
                    id=ball.id,
                    position=ball.positions[0],
                    covariance=ball.covariances[0],
                    angular_velocity=None
                    if ball.angular_velocities is None
                    else ball.angular_velocities[0],
                )
                for ball in balls
            ],
        )
    yield StreamDone(
        **dict(rollout.summary(final)),
        objects=[
            StreamBall(id=ball, color=COLORS[ball], covariance_source=manifest.covariance.source)
            for ball in range(manifest.objects)
        ],
    )


@dataclass(frozen=True)
class _Rollout:
    """A request whose frames have been encoded, with the moments at which that was done."""

    request: PredictRequest
    predictor: Predictor
    patience: Patience
    first: Step
    horizon: int
    side: int
    started: float
    decoded: float
    encoded: float

    def steps(self) -> Iterator[Outputs]:
        """Roll out."""
        return steps_after(self.predictor, self.first, self.horizon, self.patience.check)

    def forecast(self, outputs: Outputs, first_step: int) -> Forecast:
        """Turn stacked outputs into a forecast in the units of the user's frames."""
        manifest = self.predictor.manifest
        return assemble(outputs, manifest.covariance, first_step).rescaled(
            self.side / NETWORK_FRAME_SIZE, self.request.frame_rate / manifest.frame_rate_hz
        )

    def summary(self, final_positions: np.ndarray | None) -> ForecastSummary:
        """Tell all that is no step; called at the end, for it takes the time."""
        manifest = self.predictor.manifest
        return ForecastSummary(
            model=ModelReference(
                name=manifest.name,
                version=manifest.version,
                variant=manifest.variant,
                trained_horizon=manifest.trained_horizon,
            ),
            frame_size=(self.side, self.side),
            frame_rate=self.request.frame_rate,
            final_positions=None if final_positions is None else final_positions[0].tolist(),
            warnings=_warnings(self.request, manifest, self.horizon),
            timing_ms=timing(self.started, self.decoded, self.encoded),
        )


def timing(started: float, decoded: float, encoded: float) -> PredictTiming:
    """Return the time of every stage of a rollout that has just ended, from its moments."""
    now = time.perf_counter()
    return PredictTiming(
        decode=1e3 * (decoded - started),
        encode=1e3 * (encoded - decoded),
        rollout=1e3 * (now - encoded),
        total=1e3 * (now - started),
    )


def _begin(request: PredictRequest, registry: Registry, patience: Patience) -> _Rollout:
    """Choose the model, decode the frames and encode them."""
    patience.check()
    started = time.perf_counter()
    final_frame = request.final_frame is not None
    predictor = registry.choose(Wish(request.model, request.objects, request.scenario, final_frame))
    horizon = _horizon(request, predictor.manifest)
    frames, side = _decode(request)
    decoded = time.perf_counter()
    first = predictor.encode(frames[None])
    encoded = time.perf_counter()
    return _Rollout(request, predictor, patience, first, horizon, side, started, decoded, encoded)


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
