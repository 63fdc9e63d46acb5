from typing import Literal

class AutoscalingConfig:
    def __init__(
        self, *, min_replicas: int, max_replicas: int, target_ongoing_requests: float
    ) -> None: ...

class BackpressureConfig:
    def __init__(self, *, status_code: Literal[429, 503], retry_after_s: float) -> None: ...
