from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from ray.train import Result

class FailureConfig:
    def __init__(self, *, max_failures: int) -> None: ...

class RunConfig:
    def __init__(self, *, name: str, storage_path: str, failure_config: FailureConfig) -> None: ...

class ResultGrid:
    def __iter__(self) -> Iterator[Result]: ...

class Tuner:
    def __init__(
        self,
        trainable: Callable[[dict[str, Any]], object],
        *,
        param_space: Mapping[str, object],
        run_config: RunConfig,
    ) -> None: ...
    def fit(self) -> ResultGrid: ...

def grid_search(values: Sequence[object]) -> object: ...
def report(metrics: Mapping[str, object]) -> None: ...
