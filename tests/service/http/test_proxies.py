"""Behind a reverse proxy: whose address counts, and links below a prefix."""

import re

import pytest

from tests.service.conftest import wait_until_ready

PROXY = "192.0.2.1"


def ask(client, forwarded: str) -> int:
    return client.get("/models", headers={"x-forwarded-for": forwarded}).status_code


@pytest.mark.parametrize(
    ("trusted", "statuses"),
    [
        ((), [200, 200, 429, 429]),
        (("198.51.100.0/24",), [200, 200, 429, 429]),
        ((PROXY,), [200, 200, 200, 200]),
        (("192.0.2.0/24",), [200, 200, 200, 200]),
    ],
)
def test_clients_are_told_apart_by_a_header_of_trusted_proxies_alone(start, trusted, statuses):
    client = start(requests_per_minute=2, processes=1, trusted_proxies=trusted)
    wait_until_ready(client)
    client._transport.client = (PROXY, 1234)
    assert [ask(client, f"203.0.113.{index}") for index in range(4)] == statuses


def test_an_address_before_that_of_the_last_untrusted_hop_is_not_believed(start):
    client = start(requests_per_minute=2, processes=1, trusted_proxies=(PROXY,))
    wait_until_ready(client)
    client._transport.client = (PROXY, 1234)
    forged = [ask(client, f"203.0.113.{index}, 203.0.113.250") for index in range(4)]
    assert forged == [200, 200, 429, 429]


@pytest.mark.parametrize("passed_on", [False, True])
def test_the_description_works_below_a_prefix(start, passed_on):
    client = start(root_path="/rollcast")
    before = "/rollcast" if passed_on else ""
    page = client.get(f"{before}/docs")
    assert page.status_code == 200
    links = re.findall(r"(?:src|href|url)(?:=|: )[\"']([^\"']+)", page.text)
    assert {"/rollcast/openapi.json"} <= set(links)
    for link in links:
        path = link if passed_on else link.removeprefix("/rollcast")
        assert client.get(path).status_code == 200, link
    assert client.get(f"{before}/v2/nothing").json().keys() == {"error"}
    assert client.get(f"{before}/health/live").status_code == 200


def test_the_description_is_open_and_the_service_is_not(start, tmp_path):
    from service.auth.api_keys import KeyFile

    keys = tmp_path / "keys.json"
    KeyFile().write(keys)
    client = start(keys_file=keys)
    for path in (
        "/docs",
        "/openapi.json",
        "/",
        "/health/live",
        "/static-offline-docs/swagger-ui.css",
    ):
        assert client.get(path).status_code == 200, path
    for path in ("/models", "/metrics", "/v2"):
        assert client.get(path).status_code == 401, path


def test_head_is_answered_as_get_is_on_every_route(client):
    described = client.get("/openapi.json").json()["paths"]
    routes = [path for path, methods in described.items() if "get" in methods]
    assert len(routes) > 8
    paths = [path.replace("{name}", "dot").replace("{version}", "1") for path in routes]
    for path in ["/", "/metrics", "/openapi.json", "/docs", "/nowhere", "/predict", *paths]:
        head, get = client.head(path), client.get(path)
        assert head.status_code == get.status_code, path
        assert head.headers["content-type"] == get.headers["content-type"], path
        assert get.content
        assert head.content == b""
    counted = client.get("/metrics").text
    assert 'method="HEAD"' in counted
    assert 'http_requests_total{handler="/models/{name}",method="HEAD"' in counted
