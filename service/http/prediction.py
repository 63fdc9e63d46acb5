"""One prediction request answered, whole or step by step: decode, choose, roll out, report."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.image_sequence import numbering_warnings
from rollcast.manifest import Manifest
from rollcast.ood import frame_stats
from rollcast.outputs import FORECAST_OUTPUTS, STEP_OUTPUTS, OutputName, OutputSpec, Units
from rollcast.rollout import Outputs, finite_steps, joined, part_of_steps
from rollcast.scene import BallColor
from rollcast.schemas import (
    AUTO_MODEL,
    DEFAULT_HORIZON,
    MAX_HORIZON,
    AlternativeForecast,
    ForecastObject,
    ForecastSummary,
    ModelReference,
    Motion,
    PredictRequest,
    PredictResponse,
    SeenBall,
    StreamBall,
    StreamDone,
    StreamObject,
    StreamStep,
)
from service.errors import InvalidValueError
from service.http.found_balls import RequestBalls
from service.http.image_decoding import OpenedFrames
from service.http.request_body import Parser
from service.inference.ball_predictor import BallPredictor
from service.inference.deadlines import CancellationToken
from service.inference.rollout import (
    CovarianceFloor,
    ForecastArrays,
    Predictor,
    assemble,
    place_sigmas,
)
from service.inference.scheduler import DecodedRequest, Decoding
from service.inference.step_times import StepTimes, frame_spacing
from service.observability.metrics import Metrics
from service.observability.tracing import Stages
from service.serving.forecast_warnings import (
    left_frame,
    limit_warnings,
    lost_ball,
    out_of_distribution,
    replaced,
)
from service.serving.registry import ModelQuery, Registry

LONGEST_ROLLOUT = 4 * MAX_HORIZON
"""Most steps of a model in one forecast, whose own steps may be longer."""


class BallDetails(NamedTuple):
    """Fields of one ball that are the same at every step."""

    id: int
    color: BallColor
    covariance_source: Literal["predicted", "empirical"]
    score: float | None = None
    seen: Sequence[SeenBall] | None = None
    warnings: Sequence[str] = ()
    motion: Motion = "network"


class _Forecast(ABC):
    """One request: its model, its frames, and the times of its stages.

    Parameters
    ----------
    parse
        Parser of the request, which calls its argument regularly as a check for cancellation.
    token
        Cancels the work when the client has disconnected.
    """

    request: PredictRequest
    manifest: Manifest
    _times: StepTimes

    def __init__(
        self,
        parse: Parser[PredictRequest],
        token: CancellationToken,
        registry: Registry,
        metrics: Metrics,
    ) -> None:
        self._parse = parse
        self._token = token
        self._registry = registry
        self._stages = Stages(metrics)
        self._size = (0, 0)
        self._balls: RequestBalls | None = None
        self._details: list[BallDetails] = []
        self._number: int | None = None
        """Balls that the request names or prompts."""
        self._floor: CovarianceFloor | None = None
        self._left: dict[int, int] = {}
        """Step at which a ball leaves the frame, by its id."""
        self._begun = False
        self._rate = 0.0
        self._step_rate = 0.0
        self._horizon = 0
        self._spacing = 1.0
        """Time between two frames, in the model's steps."""
        self._warnings: list[str] = []
        self._limits: list[str] = []
        """Warnings of the model that forecasts."""

    def begin(self) -> Decoding:
        """Choose the model and decode the frames, or return a function that decodes large ones.

        Raises
        ------
        service.errors.ServiceError
            When the request cannot be served.
        """
        self.request, names = self._parse(self._token.raise_if_cancelled)
        request = self.request
        self._warnings = numbering_warnings(names)
        self._stages.begin("decode")
        final_frame = request.final_frame is not None
        prompted = request.balls is not None
        self._number = request.num_objects if request.balls is None else len(request.balls)
        if request.num_objects not in (None, self._number):
            expected = f"{self._number}, the number of balls"
            raise InvalidValueError.at("num_objects", request.num_objects, expected)
        opened = self._open()
        square = request.model != AUTO_MODEL or opened.is_square
        query = ModelQuery(
            request.model,
            self._number,
            request.scenario,
            final_frame,
            prompted,
            square=square,
            horizon=request.horizon or DEFAULT_HORIZON,
            frame_rate=request.frame_rate,
        )
        predictor = self._registry.choose(query)
        self.manifest = predictor.manifest
        self._horizon = _horizon(request, predictor.manifest)
        self._rate = request.frame_rate or predictor.manifest.frame_rate_hz
        self._step_rate = request.step_rate or self._rate
        if not isinstance(predictor, BallPredictor):
            opened.require_squares()

        def decode() -> DecodedRequest:
            return self._decoded(predictor, opened)

        return decode if opened.slow else decode()

    def _decoded(self, predictor: Predictor, opened: OpenedFrames) -> DecodedRequest:
        """Decode frames for a model; another one may replace it."""
        self._spacing = frame_spacing(predictor.manifest, self._rate)
        self._times = self._step_times()
        if isinstance(predictor, BallPredictor):
            return self._with_balls(predictor, opened)
        self._size = (opened.side, opened.side)
        frames = opened.decode()
        seen = frame_stats(frames)
        self._limits = limit_warnings(predictor, self._horizon, self._rate, seen)
        unlike = out_of_distribution(predictor, seen)
        self._warnings += unlike
        if unlike and (other := self._replacement()) is not None:
            return self._decoded_anew(other)
        source = predictor.manifest.covariance.source
        colors = predictor.manifest.colors
        self._details = [BallDetails(ball, color, source) for ball, color in enumerate(colors)]
        self._stages.begin("encode")
        return DecodedRequest(predictor, frames[None], self._times.rollout_horizon)

    def _step_times(self) -> StepTimes:
        """Return the times of the forecast's steps in the model's.

        Raises
        ------
        InvalidValueError
            When they do not suit the model.
        """
        times = StepTimes(self._spacing * self._rate / self._step_rate, self._horizon)
        fixed = self.manifest.final_step
        if fixed is not None and self._step_rate != self._rate:
            expected = f"{self._rate:g}, the frames a second: the final frame shows step {fixed}"
            raise InvalidValueError.at("step_rate", self._step_rate, expected)
        if times.rollout_horizon > LONGEST_ROLLOUT:
            most = 1 + int((LONGEST_ROLLOUT - 1) / times.spacing)
            expected = f"at most {most} at {self._step_rate:g} steps a second"
            raise InvalidValueError.at("horizon", self._horizon, expected)
        return times

    def _replacement(self, reasons: Iterable[str] = ()) -> Predictor | None:
        """Replace a choice of "auto" by the model for OOD frames, if one is served."""
        if self.request.model != AUTO_MODEL or self.manifest.random_appearances:
            return None
        other = self._registry.for_ood_frames(self.manifest)
        if other is not None:
            self._warnings += [*reasons, replaced(self.manifest, other.manifest)]
            self.manifest = other.manifest
        return other

    def _decoded_anew(self, other: Predictor) -> DecodedRequest:
        """Decode the frames once more, at the size that another model reads."""
        return self._decoded(other, self._open())

    def _open(self) -> OpenedFrames:
        """Read the headers of the frames."""
        request = self.request
        images = [*request.frames]
        fields = [f"frames[{index}]" for index in range(len(images))]
        if request.final_frame is not None:
            images.append(request.final_frame)
            fields.append("final_frame")
        return OpenedFrames(images, fields, self._token.raise_if_cancelled)

    def _with_balls(self, predictor: BallPredictor, opened: OpenedFrames) -> DecodedRequest:
        """Find the balls in the frames as they were sent."""
        request = self.request
        frames = opened.decode_whole()
        self._stages.begin("encode")
        self._size = (frames.shape[2], frames.shape[1])
        steps = np.arange(self._horizon) * (self._rate / self._step_rate)
        self._balls = balls = RequestBalls(
            predictor, frames, request.balls, self._number, self._spacing, steps
        )
        seen = frame_stats(balls.found.said["square"])
        self._limits = limit_warnings(predictor, self._horizon, self._rate, seen)
        source = predictor.manifest.covariance.source
        levels = balls.on_level_ground if request.model == AUTO_MODEL else [False] * balls.count
        told = zip(balls.colors, balls.scores, balls.seen, balls.warnings, levels, strict=True)
        self._details = [
            BallDetails(
                ball, color, source, score, seen, warnings, "kinematic" if level else "network"
            )
            for ball, (color, score, seen, warnings, level) in enumerate(told)
        ]
        return DecodedRequest(
            predictor.rollout(balls.count), balls.found.packed, self._times.rollout_horizon
        )

    def take(self, outputs: Outputs) -> Decoding | None:
        """Take the next steps of the model; after the first one, another model may replace it.

        Raises
        ------
        service.errors.DivergedError
            When a number is not finite.
        """
        if not self._begun:
            if (instead := self._if_lost(outputs)) is not None:
                return instead
            self._begun = True
            self._stages.begin("rollout")
        made = self._times.add(outputs)
        if len(made["positions"]):
            self._take(made)
        return None

    @abstractmethod
    def _take(self, outputs: Outputs) -> None:
        """Take the next steps of the forecast."""

    def _if_lost(self, outputs: Outputs) -> Decoding | None:
        """Warn of lost balls, or return the decoding for the model for OOD frames."""
        known = self.manifest.place_uncertainty
        if known is None:
            return None
        sigmas = place_sigmas(assemble(joined([outputs]), self.manifest.covariance))
        warnings = [lost_ball(self.manifest, known, sigma) for sigma in sigmas]
        if not any(warnings):
            return None
        other = self._replacement(warning for ball in warnings for warning in ball)
        if other is not None:
            return lambda: self._decoded_anew(other)
        told = zip(self._details, warnings, strict=True)
        self._details = [ball._replace(warnings=[*ball.warnings, *more]) for ball, more in told]
        return None

    def motions(
        self, outputs: Outputs, first_step: int
    ) -> tuple[ForecastArrays, ForecastArrays | None]:
        """Turn joined outputs into a forecast in pixels of 128.

        Returns
        -------
        tuple
            The forecast, and the one of the other motion from models for any number of balls.
        """
        covariance = self.manifest.covariance
        if self._floor is None:
            calibrated = covariance.empirical or covariance.variance_scale or ()
            last = (len(calibrated) or self.manifest.trained_horizon) - 1
            self._floor = CovarianceFloor(1 + int(last / self._times.spacing))
        made = assemble(outputs, covariance, first_step, self._times.spacing)
        network = self._floor.apply(made, first_step)
        if self._balls is None:
            return network, None
        kinematic = self._balls.kinematic(network, first_step)
        by_kinematics = np.array([ball.motion == "kinematic" for ball in self._details])
        return network.mixed(kinematic, by_kinematics), kinematic.mixed(network, by_kinematics)

    def in_frame(self, made: ForecastArrays) -> ForecastArrays:
        """Return a forecast in the units of the user's frames."""
        units = Units(
            max(self._size) / NETWORK_FRAME_SIZE,
            self._rate * self._spacing / self.manifest.frame_rate_hz,
            (0.0, 0.0) if self._balls is None else self._balls.origin,
        )
        return made.within_frame().rescaled(units)

    def answered(self, made: ForecastArrays, first_step: int) -> ForecastArrays:
        """Return the forecast of the answer, noting where balls leave the frame."""
        scaled = self.in_frame(made)
        places = scaled.positions[0]
        outside = np.any((places < 0) | (places > np.array(self._size)), axis=-1)
        for ball in np.flatnonzero(outside.any(axis=-1)).tolist():
            self._left.setdefault(ball, first_step + int(outside[ball].argmax()))
        return scaled

    @property
    def balls(self) -> list[BallDetails]:
        """Fields of the balls that are the same at every step, after the last one."""
        return [
            ball._replace(warnings=[*ball.warnings, left_frame(self._left[ball.id])])
            if ball.id in self._left
            else ball
            for ball in self._details
        ]

    def summary(self, outputs: Mapping[OutputName, np.ndarray]) -> ForecastSummary:
        """Tell all that is no step; called at the end, for it takes the time."""
        manifest = self.manifest
        taken = self._stages.end(manifest.label)
        ends: dict[OutputName, Any] = {
            spec.name: outputs[spec.name][0].tolist() if spec.name in outputs else None
            for spec in FORECAST_OUTPUTS
        }
        return ForecastSummary(
            model=ModelReference(
                name=manifest.name,
                version=manifest.version,
                variant=manifest.variant,
                trained_horizon=manifest.trained_horizon,
            ),
            frame_size=self._size,
            frame_rate=self._rate,
            step_rate=self._step_rate,
            **ends,
            warnings=[*self._limits, *self._warnings],
            timing_ms=taken,
        )


class WholeForecast(_Forecast):
    """A forecast that is answered when all its steps are there, as JSON."""

    def __init__(
        self,
        parse: Parser[PredictRequest],
        token: CancellationToken,
        registry: Registry,
        metrics: Metrics,
    ) -> None:
        super().__init__(parse, token, registry, metrics)
        self._parts: list[Outputs] = []

    def _take(self, outputs: Outputs) -> None:
        self._parts.append(outputs)

    def finish(self) -> str:
        """Write the answer.

        Raises
        ------
        service.errors.DivergedError
            When a number is not finite.
        """
        made, other = self.motions(joined(self._parts), first_step=0)
        forecast = self.answered(made, first_step=0)
        other = None if other is None else self.in_frame(other)
        response = PredictResponse(
            **dict(self.summary(forecast.outputs)),
            objects=_objects(forecast, self.balls, other),
            times_s=[step / self._step_rate for step in range(self._horizon)],
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
        parse: Parser[PredictRequest],
        token: CancellationToken,
        registry: Registry,
        metrics: Metrics,
        emit: Callable[[StreamStep | StreamDone], object],
    ) -> None:
        super().__init__(parse, token, registry, metrics)
        self._emit = emit
        self._first: Mapping[OutputName, np.ndarray] = {}
        self._handed = 0

    def _take(self, outputs: Outputs) -> None:
        finite = finite_steps(outputs)
        if 0 < finite < len(outputs["positions"]):
            # Steps before the one that diverges are handed over.
            self._take(part_of_steps(outputs, slice(finite)))
            outputs = part_of_steps(outputs, slice(finite, None))
        made, _ = self.motions(joined([outputs]), first_step=self._handed)
        forecast = self.answered(made, first_step=self._handed)
        if self._handed == 0:
            self._first = forecast.outputs
        paths = [list(_paths(forecast, ball)) for ball in self._details]
        for place, radius in enumerate(forecast.ellipse50_radii.tolist()):
            objects = [
                StreamObject(
                    id=ball.id,
                    **{spec.step_name: values[place] if values else None for spec, values in path},
                )
                for ball, path in zip(self._details, paths, strict=True)
            ]
            step, self._handed = self._handed, self._handed + 1
            self._emit(
                StreamStep(
                    step=step,
                    time_s=step / self._step_rate,
                    ellipse50_radius=radius,
                    objects=objects,
                )
            )

    def finish(self) -> None:
        """Emit the final event, with the fields that belong to no step."""
        self._emit(
            StreamDone(
                **dict(self.summary(self._first)),
                objects=[StreamBall(**ball._asdict()) for ball in self.balls],
            )
        )


def _horizon(request: PredictRequest, manifest: Manifest) -> int:
    """Return the number of steps, which a final frame fixes."""
    if manifest.final_step is None:
        return request.horizon or DEFAULT_HORIZON
    fixed = manifest.final_step + 1
    if request.horizon not in (None, fixed):
        expected = f"{fixed}: the final frame of {manifest.label} shows step {manifest.final_step}"
        raise InvalidValueError.at("horizon", request.horizon, expected)
    return fixed


def _objects(
    forecast: ForecastArrays, balls: Sequence[BallDetails], other: ForecastArrays | None
) -> list[ForecastObject]:
    return [
        ForecastObject(
            **ball._asdict(),
            **{spec.name: values for spec, values in _paths(forecast, ball)},
            alternative=None if other is None else _alternative(other, ball),
        )
        for ball in balls
    ]


def _paths(forecast: ForecastArrays, ball: BallDetails) -> Iterator[tuple[OutputSpec, Any]]:
    """Yield the outputs of a ball at all steps; kinematic motion has the required ones only."""
    for spec in STEP_OUTPUTS:
        is_known = spec.name in forecast.outputs and ball.motion != "kinematic"
        has_values = is_known or spec.is_required
        yield spec, forecast.outputs[spec.name][0, ball.id].tolist() if has_values else None


def _alternative(other: ForecastArrays, ball: BallDetails) -> AlternativeForecast:
    return AlternativeForecast(
        motion="network" if ball.motion == "kinematic" else "kinematic",
        positions=other.positions[0, ball.id].tolist(),
        covariances=other.covariances[0, ball.id].tolist(),
    )
