"""The service's image with Ray: it serves what the checkout serves."""

import socket
import time

import pytest

from rollcast.client import Client
from rollcast.errors import ClientError
from tests.e2e.conftest import ASKED, assert_same_forecasts

IMAGE = "rollcast-ray:test"
START_S = 120
PROGRAM = """
from ray import serve
from service.process.ray_serve import application
serve.start("HeadOnly", {{"host": "127.0.0.1", "port": {port}}})
serve.run(application({{}}), route_prefix="/", blocking=True)
"""


@pytest.fixture(scope="module")
def address(ray_images):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    program = PROGRAM.format(port=port)
    with ray_images.running("--entrypoint", "python", IMAGE, "-c", program):
        address = f"http://127.0.0.1:{port}"
        deadline = time.monotonic() + START_S
        while not answers(address):
            assert time.monotonic() < deadline
            time.sleep(0.2)
        yield address


def answers(address: str) -> bool:
    with Client(address, retries=0) as client:
        try:
            return client.health().status == "ready"
        except ClientError:
            return False


@pytest.mark.parametrize("asked", ASKED, ids=str)
def test_it_answers_as_the_checkout_does(address, checkout, asked):
    assert_same_forecasts(address, checkout, asked)
