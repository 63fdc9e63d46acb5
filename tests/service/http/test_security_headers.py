"""What every answer tells browsers, and which pages may read it."""

import pytest

from service.errors import ServiceError
from tests.service import samples
from tests.service.samples import body

OTHER = "https://lab.example"


def test_every_answer_says_what_a_browser_may_do_with_it(client):
    answers = [
        client.get("/"),
        client.get("/docs"),
        client.get("/models"),
        client.get("/static/app/main.js"),
        client.get("/nowhere"),
        client.get("/v2/models/nobody"),
        client.post("/predict", content=b"{"),
        client.post("/predict", json=body()),
    ]
    for answer in answers:
        assert answer.headers["x-content-type-options"] == "nosniff", answer.url
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        devices = answer.headers["permissions-policy"].split(", ")
        is_demo = answer.url.path == "/"
        assert ("camera=(self)" if is_demo else "camera=()") in devices
        assert {"microphone=()", "geolocation=()", "display-capture=()"} <= set(devices)
        policy = answer.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy
        is_page = answer.headers["content-type"].startswith("text/html")
        assert policy.startswith("default-src 'self'" if is_page else "default-src 'none'")
    assert "unsafe-inline" not in answers[0].headers["content-security-policy"]


def test_a_failure_of_the_service_says_so_too_and_nothing_of_its_cause(start):
    class Failing(samples.DotPredictor):
        def encode(self, frames, *, two_cores=False):
            raise OSError("/home/somebody/secret")

    model = samples.served()
    failing = samples.Model("dot", 1, model.manifest, Failing(model.manifest))
    answer = start(lambda _: samples.Registry([failing])).post("/predict", json=body())
    assert answer.status_code == 500
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "secret" not in answer.text
    assert "Error" not in answer.text


def test_pages_of_other_origins_may_not_read_answers_unless_they_are_named(start):
    asked = {"Origin": OTHER}
    closed, named = start(), start(allowed_origins=(OTHER,))
    assert "access-control-allow-origin" not in closed.get("/models", headers=asked).headers
    for path in ("/models", "/v2/models/nobody"):
        answer = named.get(path, headers=asked)
        assert answer.headers["access-control-allow-origin"] == OTHER
        assert answer.headers["cross-origin-resource-policy"] == "cross-origin"
        assert "X-Request-ID" in answer.headers["access-control-expose-headers"]
    other = named.get("/models", headers={"Origin": "https://evil.example"})
    assert "access-control-allow-origin" not in other.headers


def test_a_browser_asks_first_and_needs_no_key_for_that(start, tmp_path):
    keys = tmp_path / "keys.json"
    keys.write_text('{"keys": []}')
    client = start(allowed_origins=(OTHER,), keys_file=keys)
    answer = client.options(
        "/predict",
        headers={
            "Origin": OTHER,
            "Access-Control-Request-Method": "POST",
            "Access-Control-Request-Headers": "authorization,content-type,x-request-timeout-ms",
        },
    )
    assert answer.status_code == 200
    assert answer.headers["access-control-allow-origin"] == OTHER
    assert client.get("/models", headers={"Origin": OTHER}).status_code == 401


@pytest.mark.parametrize("origin", ["lab.example", "https://lab.example/page", "file:///tmp"])
def test_what_is_no_origin_is_refused(start, origin):
    with pytest.raises(ValueError, match="allowed_origins"):
        start(allowed_origins=(origin,))


def test_every_refusal_has_a_title():
    kinds = ServiceError.__subclasses__()
    assert all(kind.title for kind in kinds)
    assert len({kind.slug for kind in kinds}) == len(kinds)
