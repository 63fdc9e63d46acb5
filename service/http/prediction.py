"""One prediction request answered, whole or step by step: decode, choose, roll out, report."""

from collections.abc import Callable

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.image_sequence import numbering_warnings
from rollcast.manifest import Manifest
from rollcast.ood import frame_stats
from rollcast.rollout import Outputs, stacked
from rollcast.schemas import (
    AUTO_MODEL,
    DEFAULT_HORIZON,
    ForecastObject,
    ForecastSummary,
    ModelReference,
    PredictRequest,
    PredictResponse,
    StreamBall,
    StreamDone,
    StreamObject,
    StreamStep,
)
from service.errors import InvalidValueError
from service.http.image_decoding import Check, OpenedFrames
from service.inference.deadlines import CancellationToken
from service.inference.rollout import Forecast, Predictor, assemble
from service.inference.scheduler import DecodedRequest
from service.observability.metrics import Metrics
from service.observability.tracing import Stages
from service.serving.forecast_warnings import doubts, replaced, unfamiliar
from service.serving.registry import ModelQuery, Registry

Parser = Callable[[Check], tuple[PredictRequest, list[str]]]
"""Returns the request and the names of its files, as far as they are given."""


class _Forecast:
    """One request: its model, its frames, and the moments at which things were done.

    Parameters
    ----------
    parse
        Returns the parsed request; calls what it is given now and then, to be interrupted.
    token
        Ends the work on a request that nobody waits for.
    """

    request: PredictRequest
    manifest: Manifest

    def __init__(
        self, parse: Parser, token: CancellationToken, registry: Registry, metrics: Metrics
    ) -> None:
        self._parse = parse
        self._token = token
        self._registry = registry
        self._stages = Stages(metrics)
        self._side = 0
        self._rate = 0.0
        self._horizon = 0
        self._doubts: list[str] = []

    def begin(self) -> DecodedRequest | Callable[[], DecodedRequest]:
        """Choose the model and decode the frames, or return what decodes them if that is slow.

        Raises
        ------
        service.errors.ServiceError
            When the request cannot be served.
        """
        self.request, names = self._parse(self._token.raise_if_cancelled)
        request = self.request
        self._doubts = numbering_warnings(names)
        self._stages.next()
        final_frame = request.final_frame is not None
        query = ModelQuery(request.model, request.objects, request.scenario, final_frame)
        predictor = self._registry.choose(query)
        self.manifest = predictor.manifest
        self._horizon = _horizon(request, predictor.manifest)
        self._rate = request.frame_rate or predictor.manifest.frame_rate_hz
        opened = _open(request, self._token.raise_if_cancelled)
        self._side = opened.side

        def decode() -> DecodedRequest:
            return self._decoded(predictor, opened.decode())

        return decode if opened.slow else decode()

    def _decoded(self, predictor: Predictor, frames: np.ndarray) -> DecodedRequest:
        seen = frame_stats(frames)
        unlike = unfamiliar(predictor, seen)
        self._doubts += [*doubts(predictor, self._horizon, self._rate, seen), *unlike]
        if unlike and self.request.model == AUTO_MODEL:
            predictor = self._for_unfamiliar_frames(predictor)
        self._stages.next()
        return DecodedRequest(predictor, frames[None], self._horizon)

    def _for_unfamiliar_frames(self, chosen: Predictor) -> Predictor:
        """Return the model that forecasts in place of a choice of "auto", if there is one."""
        other = self._registry.for_unfamiliar_frames(chosen)
        if other is None:
            return chosen
        self.manifest = other.manifest
        self._doubts = [*self._doubts, replaced(chosen.manifest, other.manifest)]
        return other

    def step(self, index: int, outputs: Outputs) -> None:  # noqa: ARG002
        """Note when the first step is there: the frames are encoded."""
        if index == 0:
            self._stages.next()

    def forecast(self, outputs: Outputs, first_step: int) -> Forecast:
        """Turn stacked outputs into a forecast in the units of the user's frames."""
        return assemble(outputs, self.manifest.covariance, first_step).rescaled(
            self._side / NETWORK_FRAME_SIZE, self._rate / self.manifest.frame_rate_hz
        )

    def summary(self, final_positions: np.ndarray | None) -> ForecastSummary:
        """Tell all that is no step; called at the end, for it takes the time."""
        manifest = self.manifest
        taken = self._stages.end(manifest.label)
        return ForecastSummary(
            model=ModelReference(
                name=manifest.name,
                version=manifest.version,
                variant=manifest.variant,
                trained_horizon=manifest.trained_horizon,
            ),
            frame_size=(self._side, self._side),
            frame_rate=self._rate,
            final_positions=None if final_positions is None else final_positions[0].tolist(),
            warnings=self._doubts,
            timing_ms=taken,
        )


class WholeForecast(_Forecast):
    """A forecast that is answered when all its steps are there, as JSON."""

    def __init__(
        self, parse: Parser, token: CancellationToken, registry: Registry, metrics: Metrics
    ) -> None:
        super().__init__(parse, token, registry, metrics)
        self._steps: list[Outputs] = []

    def step(self, index: int, outputs: Outputs) -> None:
        """Keep a step's outputs."""
        super().step(index, outputs)
        self._steps.append(outputs)

    def finish(self) -> str:
        """Write the answer.

        Raises
        ------
        service.errors.DivergedError
            When a number is not finite.
        """
        forecast = self.forecast(stacked(self._steps), first_step=0)
        response = PredictResponse(
            **dict(self.summary(forecast.final_positions)),
            objects=_objects(forecast, self.manifest),
            times_s=[step / self._rate for step in range(len(self._steps))],
            ellipse50_radii=forecast.ellipse50_radii.tolist(),
        )
        return response.model_dump_json()


class StreamedForecast(_Forecast):
    """A forecast that is handed over step by step, and closed with all that is no step.

    Parameters
    ----------
    emit
        Takes the events.
    """

    def __init__(
        self,
        parse: Parser,
        token: CancellationToken,
        registry: Registry,
        metrics: Metrics,
        emit: Callable[[StreamStep | StreamDone], object],
    ) -> None:
        super().__init__(parse, token, registry, metrics)
        self._emit = emit
        self._final: np.ndarray | None = None

    def step(self, index: int, outputs: Outputs) -> None:
        """Hand a step over.

        Raises
        ------
        service.errors.DivergedError
            When a number is not finite.
        """
        super().step(index, outputs)
        forecast = self.forecast(stacked([outputs]), first_step=index)
        if index == 0:
            self._final = forecast.final_positions
        self._emit(
            StreamStep(
                step=index,
                time_s=index / self._rate,
                ellipse50_radius=forecast.ellipse50_radii.item(),
                objects=[
                    StreamObject(
                        id=ball.id,
                        position=ball.positions[0],
                        covariance=ball.covariances[0],
                        angular_velocity=None
                        if ball.angular_velocities is None
                        else ball.angular_velocities[0],
                    )
                    for ball in _objects(forecast, self.manifest)
                ],
            )
        )

    def finish(self) -> None:
        """Hand over what is no step."""
        source = self.manifest.covariance.source
        self._emit(
            StreamDone(
                **dict(self.summary(self._final)),
                objects=[
                    StreamBall(id=ball, color=color, covariance_source=source)
                    for ball, color in enumerate(self.manifest.colors)
                ],
            )
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


def _open(request: PredictRequest, check: Check) -> OpenedFrames:
    fields = [f"frames[{index}]" for index in range(len(request.frames))]
    if request.final_frame is None:
        return OpenedFrames(request.frames, fields, check)
    return OpenedFrames([*request.frames, request.final_frame], [*fields, "final_frame"], check)


def _objects(forecast: Forecast, manifest: Manifest) -> list[ForecastObject]:
    turning = forecast.angular_velocities
    return [
        ForecastObject(
            id=ball,
            color=color,
            positions=forecast.positions[0, ball].tolist(),
            covariances=forecast.covariances[0, ball].tolist(),
            covariance_source=manifest.covariance.source,
            angular_velocities=None if turning is None else turning[0, ball].tolist(),
        )
        for ball, color in enumerate(manifest.colors)
    ]
