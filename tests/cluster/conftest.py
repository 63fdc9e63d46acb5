import os

# In bfloat16, which processors with AVX-512 train in, the batches' halves round differently, and
# curves of one and of two workers part. Inherited by Ray's processes; read with torch's first sum.
os.environ["ATEN_CPU_CAPABILITY"] = "avx2"  # noqa: TID251 - before any import of torch

from collections.abc import Iterator

import pytest

from tests.cluster.nodes import Nodes, nodes
from tests.e2e.conftest import serving


@pytest.fixture(scope="module")
def running() -> Iterator[Nodes]:
    """The service on three nodes."""
    with nodes(3) as started:
        yield started


@pytest.fixture(scope="session")
def checkout() -> Iterator[str]:
    """The address of the server run from the checkout."""
    with serving() as address:
        yield address
