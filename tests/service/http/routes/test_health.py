import re
import threading

from tests.service import samples
from tests.service.samples import body


def test_ready_and_live_with_models(client):
    assert client.get("/health/live").json() == {"status": "live"}
    assert client.get("/health/ready").json() == {"status": "ready"}


def test_not_ready_while_loading(start):
    loaded = threading.Event()

    def load(folder):
        loaded.wait(30)
        return samples.registry(folder)

    client = start(load)
    try:
        response = client.get("/health/ready")
        assert (response.status_code, response.json()) == (503, {"status": "loading"})
        assert client.get("/health/live").status_code == 200
        refused = client.post("/predict", json=body())
        assert refused.status_code == 503
        assert refused.json()["type"] == "/problems/not-ready"
        assert refused.headers["retry-after"] == "1"
    finally:
        loaded.set()


def test_not_ready_without_a_usable_model(start):
    client = start(lambda _: samples.Registry([samples.Model("broken", 1, reason="bad")]))
    response = client.get("/health/ready")
    assert (response.status_code, response.json()) == (503, {"status": "no usable model"})
    assert client.post("/predict", json=body()).json()["type"] == "/problems/not-ready"


def test_not_ready_while_draining(client):
    client.app.state.service.phase = "draining"
    response = client.get("/health/ready")
    assert (response.status_code, response.json()) == (503, {"status": "draining"})
    assert client.post("/predict", json=body()).status_code == 503


def test_the_home_page_names_the_endpoints(client):
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert all(path in page.text for path in ("/predict", "/simulate", "/models", "/v2", "/docs"))


def test_the_documentation_needs_no_other_host(client):
    page = client.get("/docs").text
    assert "://" not in page
    files = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert len(files) >= 3
    for file in files:
        assert client.get(file).status_code == 200, file
