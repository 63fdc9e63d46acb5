"""The real service, as other people's clients of the Open Inference Protocol find it."""

from collections.abc import Iterator

import numpy as np
import pytest

from rollcast.client import Client
from tests.e2e.conftest import start_service, stop_service, wait_until_ready

HORIZON = 12


@pytest.fixture(scope="session")
def address() -> Iterator[str]:
    """Host and port."""
    process, url = start_service()
    with Client(url) as client:
        wait_until_ready(client)
    yield url.removeprefix("http://")
    stop_service(process)


@pytest.fixture(scope="session")
def frames(address: str) -> np.ndarray:
    """Four frames of a scene [1, 4, 128, 128, 3]."""
    with Client(f"http://{address}") as client:
        return client.simulate("ellipsoid", seed=11).frames[None, :4]


@pytest.fixture(scope="session")
def expected(address: str, frames: np.ndarray) -> np.ndarray:
    """Positions [HORIZON, 2] that /predict forecasts."""
    with Client(f"http://{address}") as client:
        forecast = client.predict(list(frames[0]), model="fieldnet", horizon=HORIZON)
    return forecast.positions[0]
