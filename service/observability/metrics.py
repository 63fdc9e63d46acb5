"""Prometheus metrics of the service."""

from collections.abc import Callable

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Summary,
    generate_latest,
)
from prometheus_client.multiprocess import MultiProcessCollector

from rollcast.schemas import PredictTiming, TickStatus
from service.inference.rollout import Predictor
from service.serving.registry import Registry
from service.settings import metrics_folder

STAGE_SECONDS = (
    0.0005, 0.001, 0.002, 0.004, 0.006, 0.008, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.25, 1, 5,
)  # fmt: skip
BATCHES = (1, 2, 4, 8, 16, 32)
METHODS = frozenset({"DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT"})
"""Methods with labels of their own: clients may send dozens of others."""
PATH = "/metrics"
"""Path of the metrics; its own requests are not counted."""


class Metrics:
    """Counters of one app.

    With PROMETHEUS_MULTIPROC_DIR, they cover all processes that write to that folder.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.in_flight = Gauge(
            "rollcast_requests_in_flight",
            "Requests being computed or queued, by pool",
            ["pool"],
            registry=self.registry,
            multiprocess_mode="livesum",
        )
        for pool in ("inference", "simulation"):
            self.in_flight.labels(pool).set(0)  # a process that was replaced may have left its own
        self._stages = Histogram(
            "rollcast_stage_seconds",
            "Time of one stage of a forecast",
            ["stage", "model"],
            registry=self.registry,
            buckets=STAGE_SECONDS,
        )
        self._batch = Histogram(
            "rollcast_batch_size",
            "Forecasts per rollout batch",
            ["model"],
            registry=self.registry,
            buckets=BATCHES,
        )
        self.sessions = Gauge(
            "rollcast_sessions",
            "Open sessions",
            registry=self.registry,
            multiprocess_mode="livesum",
        )
        self.sessions.set(0)
        self._ticks = Counter(
            "rollcast_session_ticks",
            "Answered frames of sessions, by status",
            ["status"],
            registry=self.registry,
        )
        self._rejected = Counter(
            "rollcast_rejected_requests", "Rejected requests", ["reason"], registry=self.registry
        )
        names = ["handler", "method"]
        self._requests = Counter(
            "http_requests", "Answered requests", [*names, "status"], registry=self.registry
        )
        self._durations = Histogram(
            "http_request_duration_seconds",
            "Time from the head of a request to the end of its response",
            names,
            registry=self.registry,
            buckets=STAGE_SECONDS,
        )
        self.loading = Summary(
            "rollcast_loading_seconds",
            "Time for loading the models at the start of a process",
            registry=self.registry,
        )
        self._models = Gauge(
            "rollcast_models",
            "Model versions by status",
            ["status"],
            registry=self.registry,
            multiprocess_mode="livemostrecent",
        )

    def forecast(self, model: str, timing: PredictTiming) -> None:
        """Count a forecast.

        Parameters
        ----------
        model
            NAME@VERSION.
        """
        for stage in ("decode", "encode", "rollout"):
            self._stages.labels(stage, model).observe(getattr(timing, stage) / 1e3)

    def batches(self, predictor: Predictor) -> Callable[[float], None]:
        """Return the observer of rollout batch sizes."""
        return self._batch.labels(predictor.manifest.label).observe

    def refusal(self, problem: str) -> None:
        """Count a refused request by the last part of its problem's type."""
        self._rejected.labels(problem).inc()

    def tick(self, status: TickStatus) -> None:
        """Count an answered frame of a session."""
        self._ticks.labels(status).inc()

    def models(self, registry: Registry) -> None:
        """Set the number of models, and create the metrics of served models."""
        for predictor in registry.served:
            self.batches(predictor)
        for status in ("ready", "invalid", "unloaded"):
            found = sum(model.status == status for model in registry.models)
            self._models.labels(status).set(found)

    def request(self, route: str, method: str, status: int, seconds: float) -> None:
        """Count and time a request by the template of its path."""
        method = method if method in METHODS else "other"
        if route != PATH:
            self._requests.labels(route, method, str(status)).inc()
            self._durations.labels(route, method).observe(seconds)

    def text(self) -> bytes:
        """Return all figures in Prometheus' text format."""
        registry = self.registry
        if metrics_folder() is not None:
            registry = CollectorRegistry()
            MultiProcessCollector(registry)
        return generate_latest(registry)
