import time
from collections.abc import Callable, Iterator

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from tests.service import samples


def wait_until_ready(client: TestClient) -> None:
    deadline = time.monotonic() + 30
    while client.get("/health/ready").json()["status"] == "loading":
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def start(tmp_path) -> Iterator[Callable[..., TestClient]]:
    """Start the app with some settings changed and models of one's own."""
    clients: list[TestClient] = []

    def _start(load=samples.registry, **settings: object) -> TestClient:
        app = create_app(Settings(models_dir=tmp_path, **settings), load)
        client = TestClient(app, raise_server_exceptions=False)
        clients.append(client)
        return client.__enter__()

    yield _start
    for client in clients:
        client.__exit__(None, None, None)


@pytest.fixture
def client(start) -> TestClient:
    """The app with one fake model of each kind."""
    client = start()
    wait_until_ready(client)
    return client
