"""What Prometheus reads of the service."""

import subprocess
import sys
from collections.abc import Callable

from prometheus_client.parser import text_string_to_metric_families

from tests.service.samples import body


def figures(client) -> Callable[..., float | None]:
    """Reads a sample by its name and its labels' values."""
    response = client.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    values = {
        (sample.name, frozenset(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }
    return lambda name, *labels: values.get((name, frozenset(labels)))


def test_models_are_counted_by_their_status(client):
    counted = figures(client)
    assert counted("rollcast_models", "ready") == 6
    assert counted("rollcast_models", "invalid") == 1
    assert counted("rollcast_models", "unloaded") == 0


def test_every_rollout_is_counted_by_stage_and_batch(client):
    client.post("/predict", json=body(horizon=3))
    client.post("/predict/stream", json=body(horizon=3))
    frames = {
        "name": "frames",
        "shape": [2, 4, 128, 128, 3],
        "datatype": "UINT8",
        "data": [0] * (2 * 4 * 128 * 128 * 3),
    }
    assert client.post("/v2/models/dot/infer", json={"inputs": [frames]}).status_code == 200
    counted = figures(client)
    for stage in ("decode", "encode", "rollout"):
        assert counted("rollcast_stage_seconds_count", stage, "dot@1") == 3
        assert counted("rollcast_stage_seconds_sum", stage, "dot@1") > 0
    # Two requests of two steps in one call, and two forecasts of nineteen steps in three calls.
    assert counted("rollcast_batch_size_sum", "dot@1") == 1 + 1 + 2 * 3
    assert counted("rollcast_requests_in_flight", "inference") == 0


def test_refusals_are_counted_by_their_problem(client):
    client.post("/predict", json=body(horizon=0))
    client.post("/predict", json=body(model="nobody"))
    client.post("/predict", content=b"{", headers={"content-type": "application/json"})
    counted = figures(client)
    assert counted("rollcast_rejected_requests_total", "invalid-value") == 1
    assert counted("rollcast_rejected_requests_total", "unknown-model") == 1
    assert counted("rollcast_rejected_requests_total", "malformed-body") == 1


def test_requests_are_counted_by_route_and_status(client):
    client.get("/models/dot")
    client.get("/models/line")
    client.get("/models/nobody")
    client.get("/no/such/page")
    client.get("/metrics")
    counted = figures(client)
    assert counted("http_requests_total", "/metrics", "200", "GET") is None
    assert counted("http_requests_total", "/models/{name}", "200", "GET") == 2
    assert counted("http_requests_total", "/models/{name}", "404", "GET") == 1
    assert counted("http_requests_total", "/no/such/page", "404", "GET") is None
    assert counted("http_request_duration_seconds_count", "/models/{name}", "GET") == 3
    assert counted("http_request_duration_seconds_sum", "/models/{name}", "GET") > 0


def test_unusual_methods_share_a_label(client):
    for method in ("PROPFIND", "MKCOL", "SEARCH"):
        assert client.request(method, "/predict").status_code == 405
    assert figures(client)("http_requests_total", "/predict", "405", "other") == 3


def test_a_process_continues_the_counters_of_its_name_in_files_that_do_not_grow(tmp_path):
    count = (
        "from pathlib import Path;"
        "from service.observability.shared_metrics import reserve_metrics, write_metrics_as;"
        f"reserve_metrics(Path({str(tmp_path)!r}), 'worker-0'); write_metrics_as('worker-0');"
        "from service.observability.metrics import Metrics;"
        "m = Metrics();"
        "held = m.in_flight.labels('inference'); assert held._value.get() == 0; held.inc();"
        "[m.request(f'/route/{k}', 'GET', 200, 1.0) for k in range(100)];"
        "m.request('/predict', 'GET', 200, 1.0);"
        "print(m.text().decode())"
    )
    sizes = set()
    for process in (1, 2):
        done = subprocess.run(
            [sys.executable, "-c", count],
            env={"PROMETHEUS_MULTIPROC_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        samples = [
            sample
            for family in text_string_to_metric_families(done.stdout)
            for sample in family.samples
        ]
        (counted,) = [
            sample.value
            for sample in samples
            if sample.name == "http_requests_total" and sample.labels["handler"] == "/predict"
        ]
        assert counted == process
        held = [s.value for s in samples if s.name == "rollcast_requests_in_flight"]
        assert sorted(held) == [0, 1]
        files = [path.stat() for path in tmp_path.glob("*.db")]
        assert all(512 * file.st_blocks >= file.st_size for file in files)  # allocated, not sparse
        sizes |= {file.st_size for file in files}
    assert len(sizes) == 1


def test_processes_that_share_a_folder_are_counted_together(tmp_path):
    count = (
        "from service.observability.metrics import Metrics;"
        "from rollcast.schemas import PredictTiming;"
        "m = Metrics(); m.in_flight.labels('inference').inc();"
        "m.forecast('dot@1', PredictTiming(decode=1, encode=2, rollout=3, total=6));"
        "print(m.text().decode())"
    )
    for process in (1, 2):
        done = subprocess.run(
            [sys.executable, "-c", count],
            env={"PROMETHEUS_MULTIPROC_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        families = text_string_to_metric_families(done.stdout)
        sums = {s.name: s.value for family in families for s in family.samples}
        assert sums["rollcast_stage_seconds_count"] == process
