from contextlib import ExitStack

import pytest

from rollcast.client import Client
from tests.rollcast.clients import Awaiting


@pytest.fixture(params=[Client, Awaiting], ids=["blocking", "awaited"])
def client(request):
    """Makes a client of a service; each test is made with both."""
    opened = ExitStack()

    def connect(service, retries=0, **options):
        made = request.param("http://rollcast.test", transport=service, retries=retries, **options)
        return opened.enter_context(made)

    with opened:
        yield connect
