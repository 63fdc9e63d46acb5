from typing import Any

class ScalingConfig:
    def __init__(self, *, num_workers: int) -> None: ...

class FailureConfig:
    def __init__(self, *, max_failures: int) -> None: ...

class RunConfig:
    def __init__(self, *, name: str, storage_path: str, failure_config: FailureConfig) -> None: ...

class Result:
    metrics: dict[str, Any]
    return_value: Any
