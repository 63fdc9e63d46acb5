from collections.abc import Callable
from typing import Any, TypeVar

from ray.serve.config import AutoscalingConfig, BackpressureConfig

C = TypeVar("C", bound=type[Any])

class Application: ...

class Deployment:
    def options(self, **options: object) -> Deployment: ...
    def bind(self, *arguments: object) -> Application: ...

class ReplicaID:
    unique_id: str

class ReplicaContext:
    replica_id: ReplicaID

def deployment(
    *,
    name: str,
    max_ongoing_requests: int,
    max_queued_requests: int,
    backpressure_config: BackpressureConfig,
    autoscaling_config: AutoscalingConfig,
    health_check_period_s: float,
    health_check_timeout_s: float,
    graceful_shutdown_wait_loop_s: float,
    graceful_shutdown_timeout_s: float,
    ray_actor_options: dict[str, Any],
) -> Callable[[type[Any]], Deployment]: ...
def ingress() -> Callable[[C], C]: ...
def get_replica_context() -> ReplicaContext: ...
