"""The app, made from its settings; its lifespan owns models and processes."""

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress

from fastapi import Depends, FastAPI
from fastapi_offline import FastAPIOffline
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from rollcast.schemas import API_VERSION
from service import model_reload
from service.auth.api_keys import ApiKeyStore
from service.auth.rate_limit import RateLimiter
from service.errors import UnknownModelError
from service.http.authorization import check_access
from service.http.compression import Compression
from service.http.head_requests import HeadAsGet
from service.http.openapi import install_openapi
from service.http.problem_details import install_problem_handlers
from service.http.root_path import RootPath
from service.http.routes import (
    detect,
    health,
    home,
    inference,
    metrics,
    models,
    predict,
    repository,
    simulate,
    stream,
)
from service.http.security_headers import install_headers
from service.inference.admission import Workers
from service.inference.body_budget import BodyBudget
from service.inference.daemon_threads import run_in_daemon_thread
from service.inference.memory import return_freed_memory
from service.inference.scheduler import Scheduler
from service.observability.log_config import install_access_log
from service.observability.metrics import Metrics
from service.serving.loading import Loader, load_registry
from service.serving.model_changes import ModelChanges
from service.settings import Settings
from service.simulation.pool import RecycledProcess
from service.state import AppState

ACCEPT_AFTER_S = 10.0
"""Longest time for which a worker process that loads its models leaves connections to others."""
POLL_S = 0.02


def create_app(
    settings: Settings, load: Loader = load_registry, changes: ModelChanges | None = None
) -> FastAPI:
    """Make the service.

    Parameters
    ----------
    settings
        See ``service.settings``.
    load
        Loads the models of a folder, off the event loop.
    changes
        Loads and unloads that the other worker processes follow too, if there are any.
    """
    figures = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        state = AppState(
            settings,
            inference=Scheduler(
                settings.inference_threads,
                settings.inference_threads + settings.inference_queue,
                settings.max_batch,
                figures.in_flight.labels("inference"),
                figures.batches,
            ),
            simulation=Workers(
                RecycledProcess(settings.simulation_timeout_s),
                1 + settings.simulation_queue,
                figures.in_flight.labels("simulation"),
            ),
            metrics=figures,
            load=load,
            bodies=BodyBudget(settings.max_total_body_bytes),
            api_keys=None if settings.keys_file is None else ApiKeyStore(settings.keys_file),
            rate_limiter=None
            if settings.requests_per_minute is None
            else RateLimiter(settings.requests_per_minute),
            changes=changes,
        )
        app.state.service = state
        return_freed_memory()
        loading = asyncio.create_task(_load(state))
        if changes is not None:
            await _other_workers_accept(state, loading)
        yield
        state.drain()
        loading.cancel()
        with suppress(asyncio.CancelledError):
            await loading
        state.inference.close()
        state.simulation.close()

    # FastAPI's own /docs loads its scripts from another host.
    app = FastAPIOffline(
        title="Rollcast",
        version=API_VERSION,
        description="Forecasts where rolling balls go from four video frames.",
        lifespan=lifespan,
        redoc_url=None,
        dependencies=[Depends(check_access)],
        # Figures and logs have homes of their own.
        telemetry={
            "auto_configure": settings.traces,
            "tracing": settings.traces,
            "metrics": False,
            "logs": False,
            "operation_spans": False,
        },
    )
    install_problem_handlers(app)
    install_openapi(app)
    app.add_middleware(HeadAsGet)
    install_access_log(app, settings.replica, figures.request)
    app.add_middleware(Compression)
    install_headers(app, settings.allowed_origins)
    if settings.root_path:
        app.add_middleware(RootPath, prefix=settings.root_path)
    if settings.trusted_proxies:
        trusted = [str(network) for network in settings.trusted_proxies]
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=trusted)
    for feature in (
        predict,
        stream,
        detect,
        simulate,
        models,
        inference,
        repository,
        health,
        metrics,
        home,
    ):
        app.include_router(feature.router)
    home.install_static_files(app)
    return app


async def _load(state: AppState) -> None:
    """Load the models while the service already answers that it does so."""
    with state.metrics.loading.time():
        registry = await run_in_daemon_thread(state.load, state.settings.models_dir)
    if state.changes is not None:
        for name in state.changes.unloaded:
            with suppress(UnknownModelError):  # its folder is gone
                registry = registry.without(name)
    state.serve(registry)
    if state.phase == "loading":
        state.phase = "serving"
    if state.changes is not None:
        await model_reload.follow(state, state.changes)


async def _other_workers_accept(state: AppState, loading: asyncio.Task[None]) -> None:
    """Delay the first connection of a worker until its models are there, but not for long.

    Requests go to workers that can answer them. Where models take long to load, every worker
    answers that it is loading instead.
    """
    deadline = time.monotonic() + ACCEPT_AFTER_S
    while state.phase == "loading" and time.monotonic() < deadline and not loading.done():
        await asyncio.sleep(POLL_S)
