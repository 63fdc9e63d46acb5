# The part of Ray that Rollcast uses; the environment of the types does not have Ray.
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

class ObjectRef: ...

class RemoteFunction:
    def remote(self, *arguments: object) -> ObjectRef: ...

def remote(
    *, max_calls: int, max_retries: int
) -> Callable[[Callable[..., object]], RemoteFunction]: ...
def init(
    *, address: str, log_to_driver: bool, runtime_env: Mapping[str, object]
) -> AbstractContextManager[object]: ...
def wait(
    references: Sequence[ObjectRef],
) -> tuple[list[ObjectRef], list[ObjectRef]]: ...
def get(reference: ObjectRef) -> Any: ...
