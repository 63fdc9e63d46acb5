"""The app, made from its settings; its lifespan owns models and processes."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from fastapi import FastAPI
from fastapi_offline import FastAPIOffline

from rollcast.http import API_VERSION
from service.loading import load_registry
from service.openapi import install_openapi
from service.problems import install_problem_handlers
from service.registry import Registry
from service.routes import health, home, inference, models, predict, simulate
from service.settings import Settings
from service.simulations import RecycledProcess
from service.state import State
from service.workers import Workers


def create_app(settings: Settings, load: Callable[[Path], Registry] = load_registry) -> FastAPI:
    """Make the service.

    Parameters
    ----------
    settings
        See ``service.settings``.
    load
        Loads the models of a folder, off the event loop.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        state = State(
            settings,
            inference=Workers(
                ThreadPoolExecutor(settings.inference_threads, "inference"),
                settings.inference_threads + settings.inference_queue,
            ),
            simulation=Workers(
                RecycledProcess(settings.simulation_recycle), 1 + settings.simulation_queue
            ),
        )
        app.state.service = state
        loading = asyncio.create_task(_load(state, load))
        yield
        state.phase = "draining"
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
    )
    install_problem_handlers(app)
    install_openapi(app)
    for feature in (predict, simulate, models, inference, health, home):
        app.include_router(feature.router)
    return app


async def _load(state: State, load: Callable[[Path], Registry]) -> None:
    """Load the models while the service already answers that it does so."""
    state.registry = await asyncio.to_thread(load, state.settings.models_dir)
    state.phase = "serving"
