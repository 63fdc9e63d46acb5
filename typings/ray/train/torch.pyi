from collections.abc import Callable

from ray.train import Result, RunConfig, ScalingConfig

class TorchConfig:
    def __init__(self, *, backend: str) -> None: ...

class TorchTrainer:
    def __init__(
        self,
        loop: Callable[[], object],
        *,
        torch_config: TorchConfig,
        scaling_config: ScalingConfig,
        run_config: RunConfig,
    ) -> None: ...
    def fit(self) -> Result: ...
