"""A traced request, as a collector receives it."""

import gzip
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx2
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from rollcast.client import Client
from tests.e2e.conftest import start_service, stop_service, wait_until_ready

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"


class Collector(ThreadingHTTPServer):
    """Keeps what services send to ``/v1/traces``."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Receiver)
        self.received: list[ExportTraceServiceRequest] = []

    @property
    def spans(self) -> list[Span]:
        return [
            span
            for request in self.received
            for resource in request.resource_spans
            for scope in resource.scope_spans
            for span in scope.spans
        ]


class Receiver(BaseHTTPRequestHandler):
    server: Collector

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        if self.headers.get("content-encoding") == "gzip":
            body = gzip.decompress(body)
        assert self.path == "/v1/traces"
        self.server.received.append(ExportTraceServiceRequest.FromString(body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class TracedTransport(httpx2.HTTPTransport):
    """Sends requests as a part of somebody's trace."""

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        request.headers["traceparent"] = f"00-{TRACE}-{PARENT}-01"
        return super().handle_request(request)


@pytest.fixture
def collector() -> Iterator[Collector]:
    with Collector() as server:
        threading.Thread(target=server.serve_forever).start()
        yield server
        server.shutdown()


def test_a_request_is_traced_with_its_stages(collector):
    process, address = start_service(
        ROLLCAST_TRACES="true",
        OTEL_EXPORTER_OTLP_ENDPOINT=f"http://127.0.0.1:{collector.server_port}",
    )
    with Client(address, transport=TracedTransport()) as client:
        wait_until_ready(client)
        frames = client.simulate("hemisphere", seed=3).frames
        client.predict(frames[:4], horizon=5)
    stop_service(process)

    (named,) = {
        attribute.value.string_value
        for request in collector.received
        for resource in request.resource_spans
        for attribute in resource.resource.attributes
        if attribute.key == "service.name"
    }
    assert named == "rollcast"
    (request,) = (span for span in collector.spans if span.name == "POST /predict")
    assert request.trace_id.hex() == TRACE
    assert request.parent_span_id.hex() == PARENT
    stages = [span for span in collector.spans if span.parent_span_id == request.span_id]
    assert [span.name for span in stages] == ["decode", "encode", "rollout"]
    moments = [request.start_time_unix_nano]
    for stage in stages:
        moments += [stage.start_time_unix_nano, stage.end_time_unix_nano]
    assert sorted(moments) == moments
    assert moments[-1] < request.end_time_unix_nano
    assert {attribute.key for attribute in stages[0].attributes} == {"rollcast.model"}
