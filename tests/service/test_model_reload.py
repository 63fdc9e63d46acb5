"""Models come and go while the service answers."""

import threading
from dataclasses import replace

import pytest

from tests.service import samples
from tests.service.conftest import wait_until_ready
from tests.service.samples import body

LOAD, UNLOAD = "/v2/repository/models/{}/load", "/v2/repository/models/{}/unload"


@pytest.fixture
def disk():
    """Versions that the folder of models holds, by name; a test may change them."""
    models = samples.registry(None).models
    return {name: [m for m in models if m.name == name] for name in {m.name for m in models}}


@pytest.fixture
def client(start, disk):
    def load(_, name=None):
        wanted = disk.values() if name is None else [disk.get(name, [])]
        return samples.Registry([model for versions in wanted for model in versions])

    client = start(load)
    wait_until_ready(client)
    return client


def index(client) -> dict[str, str]:
    entries = client.post("/v2/repository/index").json()
    return {f"{one['name']}@{one['version']}": one["state"] for one in entries}


def test_the_index_lists_every_version(client):
    entries = client.post("/v2/repository/index").json()
    assert {"name": "dot", "version": "1", "state": "READY", "reason": ""} in entries
    broken = next(one for one in entries if one["name"] == "broken")
    assert (broken["state"], broken["reason"]) == ("UNAVAILABLE", "manifest.json is missing")


def test_an_unloaded_model_is_not_served_until_it_is_loaded(client):
    assert client.post(UNLOAD.format("line")).status_code == 200
    assert index(client)["line@1"] == "UNAVAILABLE"
    assert client.get("/models/line").json()["status"] == "unloaded"
    refused = client.post("/predict", json=body(model="line"))
    assert (refused.status_code, refused.json()["detail"]) == (503, "line@1 is unloaded")
    assert client.get("/v2/models/line/ready").status_code == 503
    assert client.post(LOAD.format("line")).status_code == 200
    assert client.post("/predict", json=body(model="line")).status_code == 200


def test_auto_leaves_unloaded_models_out(client):
    client.post(UNLOAD.format("dot"))
    assert client.post("/predict", json=body()).json()["type"] == "/problems/no-suitable-model"


def test_a_new_version_is_taken_up(client, disk):
    disk["line"].append(samples.served(name="line", version=2, default=False))
    client.post(LOAD.format("line"))
    assert client.get("/models/line").json()["versions"] == [1, 2]
    assert client.post("/predict", json=body(model="line@2")).status_code == 200


def test_a_version_whose_folder_is_gone_is_dropped(client, disk):
    disk["dot"].pop()
    client.post(LOAD.format("dot"))
    assert client.get("/models/dot").json()["versions"] == [1]


def test_a_damaged_file_leaves_the_served_version_as_it_was(client, disk):
    disk["line"][0] = replace(disk["line"][0], predictor=None, reason="encoder.onnx is missing")
    refused = client.post(LOAD.format("line"))
    assert refused.status_code == 400
    assert refused.json() == {"error": "line@1 is rejected: encoder.onnx is missing"}
    assert client.post("/predict", json=body(model="line")).status_code == 200


def test_what_is_not_there_cannot_be_loaded_or_unloaded(client):
    for path in (LOAD, UNLOAD):
        refused = client.post(path.format("nobody"))
        assert refused.status_code == 404
        assert "nobody" in refused.json()["error"]


def test_a_forecast_that_has_begun_is_answered_by_the_model_it_began_with(client, disk):
    gate, entered = threading.Event(), threading.Event()

    class Slow(samples.DotPredictor):
        def step(self, state):
            entered.set()
            gate.wait(30)
            return super().step(state)

    model = disk["line"][0]
    disk["line"][0] = replace(model, predictor=Slow(model.manifest))
    client.post(LOAD.format("line"))
    statuses = []
    forecast = threading.Thread(
        target=lambda: statuses.append(client.post("/predict", json=body(model="line")).status_code)
    )
    forecast.start()
    try:
        assert entered.wait(30)
        assert client.post(UNLOAD.format("line")).status_code == 200
    finally:
        gate.set()
        forecast.join()
    assert statuses == [200]
