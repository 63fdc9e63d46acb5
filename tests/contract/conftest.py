"""The real app with the committed models, in this process."""

import time
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings


@pytest.fixture(scope="session")
def client() -> Iterator[TestClient]:
    with TestClient(create_app(Settings())) as client:
        deadline = time.monotonic() + 60
        while client.get("/health/ready").json()["status"] == "loading":
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield client
