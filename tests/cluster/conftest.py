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
