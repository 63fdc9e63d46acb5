"""The stages of a forecast: how long each took, told to Prometheus and to the request's trace."""

import time
from typing import Literal, TypeAlias, get_args

from opentelemetry import context, trace

from rollcast.schemas import PredictTiming
from service.observability.metrics import Metrics

Stage: TypeAlias = Literal["decode", "encode", "rollout"]
NAMES: tuple[Stage, ...] = get_args(Stage)


class Stages:
    """The moments at which one stage of a forecast ended and the next began.

    Made where the request is taken, whose trace it then belongs to; told in any thread.
    """

    def __init__(self, metrics: Metrics) -> None:
        self._metrics = metrics
        self._request = context.get_current()
        self._moments: list[float] = []

    def begin(self, stage: Stage) -> None:
        """Begin a stage and end the one before; a stage that has begun goes on."""
        if NAMES.index(stage) == len(self._moments):
            self._moments.append(time.perf_counter())

    def end(self, model: str) -> PredictTiming:
        """End the last stage; return the time of every one in milliseconds.

        Parameters
        ----------
        model
            NAME@VERSION.
        """
        self._moments.append(time.perf_counter())
        begun, *ends = self._moments
        lengths = [1e3 * (end - start) for start, end in zip(self._moments, ends, strict=False)]
        taken = PredictTiming(
            **dict(zip(NAMES, lengths, strict=True)), total=1e3 * (ends[-1] - begun)
        )
        self._metrics.forecast(model, taken)
        self._trace(model)
        return taken

    def _trace(self, model: str) -> None:
        """Add a span for every stage; has no noticeable cost while tracing is off."""
        tracer = trace.get_tracer("rollcast")
        # Spans are told in nanoseconds of the wall clock.
        ahead = time.time_ns() - int(1e9 * time.perf_counter())
        for name, start, end in zip(NAMES, self._moments, self._moments[1:], strict=False):
            span = tracer.start_span(
                name,
                self._request,
                attributes={"rollcast.model": model},
                start_time=ahead + int(1e9 * start),
            )
            span.end(ahead + int(1e9 * end))
