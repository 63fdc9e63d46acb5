"""API keys: their file, and who may ask for what."""

from datetime import UTC, datetime, timedelta

import pytest
from pydantic import ValidationError

from service.auth import api_keys
from service.auth.api_keys import ApiKeyStore, Key, KeyFile, digest, new_token
from service.http.authorization import scope_for
from service.http.routes import (
    health,
    home,
    inference,
    metrics,
    models,
    predict,
    repository,
    simulate,
)
from tests.service.conftest import wait_until_ready

TODAY = datetime.now(UTC).date()


def made(name, *scopes, expires=None):
    """A key and its token."""
    token = new_token()
    scopes = scopes or ("forecast",)
    return Key(name=name, sha256=digest(token), scopes=scopes, expires=expires), token


@pytest.fixture
def keys(tmp_path):
    """A file with a key for each scope, and one that has expired."""
    path = tmp_path / "keys.json"
    known = {
        "robot": made("robot"),
        "admin": made("admin", "forecast", "manage"),
        "prometheus": made("prometheus", "metrics"),
        "old": made("old", expires=TODAY - timedelta(days=1)),
        "today": made("today", expires=TODAY),
    }
    KeyFile(keys=tuple(key for key, _ in known.values())).write(path)
    return path, {name: token for name, (_, token) in known.items()}


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture
def client(start, keys):
    client = start(keys_file=keys[0])
    wait_until_ready(client)
    return client


def test_tokens_are_long_and_differ():
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(len(token) > 43 for token in tokens)


def test_the_file_holds_no_token_and_is_its_owners(keys):
    path, tokens = keys
    assert path.stat().st_mode & 0o077 == 0
    text = path.read_text()
    assert not any(token in text for token in tokens.values())


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"keys": [{"name": "a"}]}', '{"keys": [{"name": "a b", "sha256": ""}]}',
     '{"keys": [], "more": 1}'],
)  # fmt: skip
def test_a_file_that_is_none_is_refused(tmp_path, text, start):
    path = tmp_path / "keys.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"the file|keys"):
        KeyFile.read(path)
    with pytest.raises(ValidationError, match="is not a valid key file"):
        start(keys_file=path)


def test_two_keys_of_one_name_are_refused():
    key, _ = made("robot")
    with pytest.raises(ValidationError, match="same name"):
        KeyFile(keys=(key, key))


def test_a_key_is_good_until_its_last_day(keys):
    path, tokens = keys
    ring = ApiKeyStore(path)
    found = {name: ring.find(token) for name, token in tokens.items()}
    assert {name for name, key in found.items() if key is not None} == set(tokens) - {"old"}
    assert ring.find("") is None
    assert ring.find("rollcast_\udc80") is None


def test_a_changed_file_is_read_again_and_a_broken_one_is_not(keys, monkeypatch, caplog):
    path, tokens = keys
    monkeypatch.setattr(api_keys, "CHECK_INTERVAL_S", 0.0)
    ring = ApiKeyStore(path)
    key, token = made("new")
    KeyFile(keys=(key,)).write(path)
    assert ring.find(token) == key
    assert ring.find(tokens["robot"]) is None
    path.write_text("{")
    assert ring.find(token) == key
    assert "the previous keys stay in use" in caplog.text
    path.unlink()
    assert ring.find(token) == key
    KeyFile().write(path)
    assert ring.find(token) is None


def test_every_route_has_its_scope():
    features = (health, home, inference, metrics, models, predict, repository, simulate)
    paths = [route.path for feature in features for route in feature.router.routes]
    scopes = {path: scope_for(path) for path in paths}
    everybody = {path for path, scope in scopes.items() if scope is None}
    assert everybody == {
        "/",
        "/health/live",
        "/health/ready",
        "/v2/health/live",
        "/v2/health/ready",
    }
    assert {path for path, scope in scopes.items() if scope == "manage"} == {
        "/v2/repository/models/{name}/load",
        "/v2/repository/models/{name}/unload",
    }
    assert scopes["/metrics"] == "metrics"


def test_who_watches_needs_no_key(client):
    for path in ("/", "/health/live", "/health/ready", "/v2/health/live", "/static/index.html"):
        assert client.get(path).status_code == 200, path


@pytest.mark.parametrize("method", ["get", "post"])
@pytest.mark.parametrize(
    "header",
    [
        {},
        {"Authorization": "Basic abc"},
        {"Authorization": "Bearer"},
        bearer("rollcast_no"),
        {"Authorization": b"Bearer \xc3\xa9"},
    ],
)
def test_without_a_good_key_it_is_401(client, method, header):
    path = "/models" if method == "get" else "/predict"
    answer = client.request(method, path, headers=header)
    assert answer.status_code == 401
    assert answer.headers["WWW-Authenticate"] == "Bearer"
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert answer.json()["type"] == "/problems/unauthorized"
    assert set(client.get("/v2", headers=header).json()) == {"error"}


def test_a_key_that_has_expired_is_as_good_as_none(client, keys):
    _, tokens = keys
    assert client.get("/models", headers=bearer(tokens["old"])).status_code == 401
    assert client.get("/models", headers=bearer(tokens["today"])).status_code == 200


@pytest.mark.parametrize(
    ("name", "listed", "loaded", "figures"),
    [("robot", 200, 403, 403), ("admin", 200, 404, 403), ("prometheus", 403, 403, 200)],
)
def test_a_key_may_what_its_scopes_say(client, keys, name, listed, loaded, figures):
    _, tokens = keys
    header = bearer(tokens[name])
    assert client.get("/models", headers=header).status_code == listed
    assert client.post("/v2/repository/models/no/load", headers=header).status_code == loaded
    refused = client.get("/metrics", headers=header)
    assert refused.status_code == figures
    if figures == 403:
        assert refused.json()["type"] == "/problems/forbidden"
        assert tokens[name] not in refused.text


def test_without_a_file_nobody_is_asked(start):
    client = start()
    wait_until_ready(client)
    for path in ("/models", "/metrics", "/v2"):
        assert client.get(path).status_code == 200


def test_each_address_may_ask_so_often(start):
    client = start(requests_per_minute=3)
    statuses = [client.get("/models").status_code for _ in range(4)]
    assert statuses == [200, 200, 200, 429]
    refused = client.get("/models")
    assert refused.json()["type"] == "/problems/too-many-requests"
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    # What watches over the process may always ask.
    assert client.get("/health/ready").status_code == 200
    assert client.get("/metrics").status_code == 200
    assert (
        client.get("/v2/models/nobody")
        .json()["error"]
        .startswith("testclient exceeded the rate limit of 3 ")
    )


def test_each_key_may_ask_so_often_and_takes_nothing_from_others(start, keys):
    path, tokens = keys
    client = start(keys_file=path, requests_per_minute=2)

    def ask(name: str) -> int:
        headers = {"Authorization": f"Bearer {tokens[name]}"}
        return client.get("/models", headers=headers).status_code

    assert [ask("robot") for _ in range(3)] == [200, 200, 429]
    assert ask("admin") == 200
    assert client.get("/models").status_code == 401
