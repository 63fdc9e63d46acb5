"""Valid answers of every call, as bytes, from the fake service; and what those calls are."""

import httpx2
import numpy as np

from rollcast.client import Client
from rollcast.client.testing import FakeService

FRAMES = np.zeros((4, 32, 32, 3), np.uint8)
HORIZON = 5


class Recording(FakeService):
    """Keeps the body of every answer by the path that was asked."""

    def __init__(self):
        super().__init__()
        self.bodies = {}

    def handle_request(self, request):
        response = super().handle_request(request)
        self.bodies[request.url.path] = response.content
        return httpx2.Response(
            response.status_code, headers=response.headers, content=response.content
        )


CALLS = {
    "/health/ready": lambda client: client.health(),
    "/models": lambda client: client.models(),
    "/models/fake": lambda client: client.model("fake"),
    "/simulate": lambda client: client.simulate(
        "ellipsoid", seed=1, steps=5, image_size=32, include_surface=True
    ),
    "/predict": lambda client: client.predict(FRAMES, horizon=HORIZON, num_objects=2),
    "/predict/stream": lambda client: whole_stream(client),
}
"""Every call of the client by its path."""


def whole_stream(client):
    stream = client.predict_stream(FRAMES, horizon=HORIZON, num_objects=2)
    steps = list(stream)
    assert len(steps) == HORIZON
    return stream.forecast


def _recorded():
    service = Recording()
    with Client(transport=service) as client:
        for call in CALLS.values():
            call(client)
    return service.bodies


ANSWERS = _recorded()
"""The body that answers each of them."""
