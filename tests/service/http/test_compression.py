"""Which answers are compressed, and that those in a control loop are not."""

import pytest
from starlette.testclient import TestClient
from starlette.types import Receive, Scope, Send

from service.http.compression import SMALLEST_ANSWER, SMALLEST_TEXT, Compression


def answering(size: int, kind: str) -> TestClient:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        headers = [(b"content-type", kind.encode()), (b"content-length", str(size).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": b"1" * size})

    return TestClient(Compression(app))


@pytest.mark.parametrize(
    ("method", "size", "kind", "compressed"),
    [
        ("GET", SMALLEST_TEXT, "application/json", True),
        ("GET", SMALLEST_TEXT - 1, "application/json", False),
        ("POST", SMALLEST_ANSWER, "application/json", True),
        ("POST", SMALLEST_ANSWER - 1, "application/json", False),
        ("POST", SMALLEST_ANSWER, "text/event-stream", False),
        ("GET", SMALLEST_ANSWER, "image/png", False),
    ],
)
def test_large_answers_are_compressed(method, size, kind, compressed):
    answer = answering(size, kind).request(method, "/", headers={"Accept-Encoding": "gzip"})
    assert (answer.headers.get("content-encoding") == "gzip") == compressed
    assert answer.content == b"1" * size


def test_nothing_is_compressed_for_those_who_do_not_take_that():
    client = answering(SMALLEST_ANSWER, "application/json")
    answer = client.post("/", headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in answer.headers
