"""State of the running app, created and released by its lifespan."""

import asyncio
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Annotated, Literal

from fastapi import Depends
from starlette.requests import HTTPConnection

from service.auth.api_keys import ApiKeyStore
from service.auth.rate_limit import RateLimiter
from service.errors import NotReadyError
from service.inference.admission import Workers
from service.inference.body_budget import BodyBudget
from service.inference.scheduler import Scheduler
from service.observability.metrics import Metrics
from service.serving.loading import Loader
from service.serving.model_changes import ModelChanges
from service.serving.registry import Registry
from service.settings import Settings


@dataclass
class AppState:
    """The running service.

    Attributes
    ----------
    settings
        Settings at the start.
    inference, simulation
        Executors of forecasts and simulations.
    metrics
        Metrics of the service.
    load
        Function that loads models from their folder.
    bodies
        Budget of request bodies in memory.
    api_keys
        API keys; None if no key is required.
    rate_limiter
        Rate limiter; None without a limit.
    changes
        Model changes shared by all worker processes; None for a single process.
    registry
        The models; empty while loading.
    changing
        Lock for loading and unloading models.
    phase
        ``loading`` until the models are loaded, ``draining`` after a stop signal.
    draining
        Event that ends sessions.
    sessions
        Number of open sessions.
    """

    settings: Settings
    inference: Scheduler
    simulation: Workers
    metrics: Metrics
    load: Loader
    bodies: BodyBudget
    api_keys: ApiKeyStore | None = None
    rate_limiter: RateLimiter | None = None
    changes: ModelChanges | None = None
    registry: Registry = field(default_factory=lambda: Registry([]))
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)
    phase: Literal["loading", "serving", "draining"] = "loading"
    draining: asyncio.Event = field(default_factory=asyncio.Event)
    sessions: int = 0

    @property
    def readiness(self) -> Literal["ready", "loading", "no usable model", "draining"]:
        """Readiness, and its reason."""
        if self.phase != "serving":
            return self.phase
        return "ready" if self.registry.served else "no usable model"

    @property
    def idle(self) -> bool:
        """Return whether nothing is being computed and no session is open."""
        return self.inference.idle and self.simulation.idle and not self.sessions

    def drain(self) -> None:
        """Refuse new forecasts and end sessions; called in the event loop."""
        self.phase = "draining"
        self.draining.set()

    @contextmanager
    def session(self) -> Generator[None]:
        """Count an open session until the block is left."""
        self.sessions += 1
        self.metrics.sessions.inc()
        try:
            yield
        finally:
            self.sessions -= 1
            self.metrics.sessions.dec()

    def serve(self, registry: Registry) -> None:
        """Replace the models; running requests keep theirs."""
        self.registry = registry
        self.metrics.models(registry)

    def require_open(self) -> None:
        """Check that requests without a model are accepted.

        Raises
        ------
        NotReadyError
            While the service drains.
        """
        if self.phase == "draining":
            raise NotReadyError(f"The service is {self.phase}.")

    def require_serving(self) -> None:
        """Check that the models are there.

        Raises
        ------
        NotReadyError
            While they are being loaded, and while the service drains.
        """
        if self.phase != "serving":
            raise NotReadyError(f"The service is {self.phase}.")


async def _state(connection: HTTPConnection) -> AppState:
    return connection.app.state.service


ServiceState = Annotated[AppState, Depends(_state)]
