"""The service past one machine: the same app as a deployment of Ray Serve.

``serve run service.process.ray_serve:application``, from the root of the checkout. Ray Serve
decides how many replicas there are, where they run, how requests queue for them, and checks and
stops them (decision 0115); everything else is the service's own.
"""

import asyncio
from logging.config import dictConfig
from typing import Any

from fastapi import FastAPI
from ray import serve
from ray.serve import Application
from ray.serve.config import AutoscalingConfig, BackpressureConfig

from service.app import create_app
from service.http.problem_details import RETRY_AFTER_S
from service.observability.log_config import configuration
from service.settings import Settings

CORES = 1
"""Cores of a replica, and with them its threads."""
MAX_ONGOING = 16
"""Requests that a replica holds: enough to step together, few enough that others get the rest."""
QUEUES = ("inference_queue", "simulation_queue")
POLL_S = 0.05


@serve.deployment(
    name="rollcast",
    max_ongoing_requests=MAX_ONGOING,
    max_queued_requests=256,
    backpressure_config=BackpressureConfig(status_code=429, retry_after_s=RETRY_AFTER_S),
    autoscaling_config=AutoscalingConfig(
        min_replicas=1,
        max_replicas=100,
        target_ongoing_requests=2,
    ),
    health_check_period_s=5,
    health_check_timeout_s=60,
    graceful_shutdown_wait_loop_s=0.5,
    graceful_shutdown_timeout_s=30,
    # As many cores as the service believes it has.
    ray_actor_options={
        "num_cpus": CORES,
        "runtime_env": {"env_vars": {"LOKY_MAX_CPU_COUNT": str(CORES)}},
    },
)
@serve.ingress()
class Replica:
    """One process that serves.

    Parameters
    ----------
    settings
        Some of ``service.settings``; they go before the variables of the environment.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        name = serve.get_replica_context().replica_id.unique_id
        # Ray Serve queues requests; the replica never refuses a request that it receives.
        held: dict[str, Any] = dict.fromkeys(QUEUES, MAX_ONGOING)
        self._settings = Settings(**held | settings, replica=name)
        dictConfig(configuration(self._settings.log_format, self._settings.log_requests))

    def __serve_build_asgi_app__(self) -> FastAPI:
        """Make the app; Ray Serve runs its lifespan."""
        self._service = create_app(self._settings)
        return self._service

    async def check_health(self) -> None:
        """Wait for the models: before that Ray Serve sends no requests.

        Raises
        ------
        RuntimeError
            When there is none to serve; Ray Serve then replaces this replica.
        """
        state = self._service.state.service
        while state.phase == "loading":
            await asyncio.sleep(POLL_S)
        if not state.registry.served:
            raise RuntimeError(f"no usable model in {self._settings.models_dir}")


def application(settings: dict[str, Any]) -> Application:
    """Return the deployment with some of ``service.settings``: the arguments of an application."""
    return Replica.bind(settings)
