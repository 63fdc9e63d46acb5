"""Request ids and JSON lines."""

import io
import json
import logging

import pytest
from pydantic import ValidationError

from service.observability.log_config import JsonLines, configuration
from tests.service.samples import body


def written(*args, name="service", level=logging.INFO, exc_info=None) -> dict[str, object]:
    """What is written of one record, read again."""
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonLines())
    handler.handle(logging.LogRecord(name, level, "", 0, args[0], args[1:], exc_info))
    return json.loads(stream.getvalue())


def test_every_answer_carries_an_id_of_its_own(client):
    ids = {client.get("/health/live").headers["x-request-id"] for _ in range(3)}
    assert len(ids) == 3
    assert all(len(one) == 32 for one in ids)


def test_a_clients_own_id_comes_back(client):
    refused = client.post("/predict", json=body(horizon=0), headers={"x-request-id": "robot-7/42"})
    assert refused.status_code == 422
    assert refused.headers["x-request-id"] == "robot-7/42"


def test_an_id_that_could_forge_log_lines_is_replaced(client):
    for bad in ('a"b', "a b", "x" * 200):
        answered = client.get("/health/live", headers={"x-request-id": bad})
        assert len(answered.headers["x-request-id"]) == 32


def test_a_failure_carries_its_id_too(client):
    client.app.state.service.registry = None
    failed = client.get("/models", headers={"x-request-id": "mine"})
    assert failed.status_code == 500
    assert failed.headers["x-request-id"] == "mine"


def test_a_line_is_one_object():
    line = written(
        "model %s\nis refused", "a", name="service.serving.loading", level=logging.WARNING
    )
    assert line.pop("time")
    assert line == {
        "level": "WARNING",
        "logger": "service.serving.loading",
        "message": "model a\nis refused",
    }


@pytest.mark.parametrize("log_requests", [True, False])
def test_requests_are_logged_unless_the_settings_say_no(client, caplog, log_requests):
    told = configuration("json", log_requests)["loggers"]["service.http.authorization"]["level"]
    with caplog.at_level(told, logger="service.http.authorization"):
        assert client.get("/models").status_code == 200
    assert len(caplog.records) == log_requests


def test_every_answer_leaves_a_line_with_its_parts(client, caplog):
    with caplog.at_level(logging.INFO, logger="service.http.authorization"):
        client.get("/models/n%0Aone", headers={"x-request-id": "mine"})
    (record,) = caplog.records
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonLines())
    handler.handle(record)
    line = json.loads(stream.getvalue())
    assert line.pop("duration_ms") > 0
    wanted = {"method": "GET", "path": "/models/n%0Aone", "status": 404}
    assert wanted.items() <= line.items()
    assert "\n" not in record.getMessage()


def test_a_replica_names_itself_in_header_and_line(start, caplog):
    client = start(replica="node-1:b")
    with caplog.at_level(logging.INFO, logger="service.http.authorization"):
        for path in ("/health/live", "/nothing"):
            assert client.get(path).headers["x-rollcast-replica"] == "node-1:b"
    assert [record.replica for record in caplog.records] == ["node-1:b"] * 2


def test_a_service_that_is_alone_has_no_replicas_name(client, caplog):
    with caplog.at_level(logging.INFO, logger="service.http.authorization"):
        assert "x-rollcast-replica" not in client.get("/health/live").headers
    assert not hasattr(caplog.records[0], "replica")


def test_a_replicas_name_that_could_forge_a_header_is_refused(start):
    with pytest.raises(ValidationError, match="replica"):
        start(replica="a\r\nb")
