"""The real app with the committed models: in this process, or at the address that is given."""

import time
from collections.abc import Iterator

import httpx2
import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings


@pytest.fixture(scope="session")
def client(request) -> Iterator[httpx2.Client]:
    if (address := request.config.getoption("--address")) is not None:
        with httpx2.Client(base_url=address, timeout=60) as client:
            yield client
        return
    with TestClient(create_app(Settings())) as client:
        deadline = time.monotonic() + 60
        while client.get("/health/ready").json()["status"] == "loading":
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield client
