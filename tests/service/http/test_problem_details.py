"""What a refusal looks like, member by member, whatever was sent."""

import json
import math

import pytest
from fastapi import FastAPI, HTTPException
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from service.app import create_app
from service.errors import (
    BodyTooSlowError,
    InvalidField,
    InvalidValueError,
    ModelUnavailableError,
    NotReadyError,
    OutOfMemoryError,
    QueueFullError,
    ServiceError,
    SimulationLostError,
    SimulationMissingError,
    UnknownModelError,
)
from service.http.problem_details import document, in_plain_words, invalid_values
from service.settings import Settings


def told(value: object) -> object:
    """What a refusal says of a value."""
    return strict(document(InvalidValueError.at("a", value, "b")))["value"]


def strict(text: str) -> dict[str, object]:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    return json.loads(text.encode("utf-8"), parse_constant=refuse)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, None),
        (True, True),
        (3, 3),
        (-4.5, -4.5),
        (2**53 - 1, 2**53 - 1),
        (2**53, "9007199254740992"),
        (-(2**53), "-9007199254740992"),
        (math.nan, "nan"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (b"abc", "3 bytes"),
        ([1, 2.5], [1, 2.5]),
        ((1, 2, 3, 4), [1, 2, 3, 4]),
        ([1, math.nan], [1, "nan"]),
        ([1, 2, 3, 4, 5], "5 items"),
        (["a"], "1 items"),
        ({"a": 1, "b": 2}, "an object of 2 fields"),
        ("a", "a"),
        ("x" * 100, "x" * 100),
        ("x" * 101, "x" * 100 + "... (1 more characters)"),
    ],
)
def test_values_are_shown_as_json_can_say_them(value, shown):
    assert told(value) == shown
    assert type(told(value)) is type(shown)


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.binary()
    | st.text(st.characters(exclude_categories=())),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)  # fmt: skip


@given(st.text(st.characters(exclude_categories=())), ANYTHING, st.text())
def test_any_refusal_is_strict_json(field, value, expected):
    problem = strict(document(InvalidValueError.at(field, value, expected)))
    assert set(problem) == {"type", "title", "status", "detail", "field", "value", "expected"}
    assert len(json.dumps(problem)) < 8000


def test_a_refusal_without_a_value_has_no_members_for_it():
    assert strict(document(NotReadyError("later"))) == {
        "type": "/problems/not-ready",
        "title": "The service is not ready",
        "status": 503,
        "detail": "later",
    }


def test_several_mistakes_are_all_told_and_the_first_stands_outside():
    error = InvalidValueError("two", [InvalidField("a", 1, "b"), InvalidField("c", 2, "d")])
    problem = strict(document(error))
    assert problem["errors"] == [
        {"field": "a", "value": 1, "expected": "b"},
        {"field": "c", "value": 2, "expected": "d"},
    ]
    assert (problem["field"], problem["value"], problem["expected"]) == ("a", 1, "b")


def test_long_words_are_shortened():
    error = InvalidValueError.at("f" * 101, 1, "e" * 601)
    problem = strict(document(error))
    assert problem["field"] == "f" * 100 + "... (1 more characters)"
    assert problem["expected"] == "e" * 600 + "... (1 more characters)"
    assert problem["detail"].endswith(" more characters)")
    assert "errors" not in problem


@pytest.mark.parametrize(
    ("error", "field", "value", "expected"),
    [
        (("missing", ("a",), {}), "a", None, "a value, the field is required"),
        (("extra_forbidden", ("a", 0, "b"), {}), "a[0].b", "in", "no such field"),
        (("too_short", ("a",), {"min_length": 4}), "a", "in", "4 items"),
        (("too_long", ("a",), {"max_length": 4}), "a", "in", "at most 4 items"),
        (("model_type", (), {}), "body", "in", "an object"),
        (("other", ("a", "b"), {}), "a.b", "in", "words"),
        (("own", (), {"field": "f", "value": 3, "expected": "e"}), "f", 3, "e"),
    ],
)
def test_pydantics_errors_are_told_in_our_words(error, field, value, expected):
    kind, place, context = error
    found = {"type": kind, "loc": place, "msg": "Input should be words", "input": "in"}
    refusal = invalid_values([found | {"ctx": context}])
    (field_error,) = refusal.field_errors
    assert (field_error.field, field_error.value, field_error.expected) == (field, value, expected)


def test_two_of_pydantics_errors_are_counted():
    found = [
        {"type": "missing", "loc": (name,), "msg": "Field required", "input": {}} for name in "ab"
    ]
    refusal = invalid_values(found)
    assert refusal.detail == "2 values are invalid: a, b"
    assert [field_error.field for field_error in refusal.field_errors] == ["a", "b"]


def test_words_of_pydantic_are_left_out():
    assert in_plain_words("Input should be a number") == "a number"
    assert in_plain_words("Value error, a number") == "a number"


FAILURES = {
    "slow": BodyTooSlowError("slow"),
    "full": QueueFullError("full"),
    "loading": NotReadyError("loading"),
    "unavailable": ModelUnavailableError("gone"),
    "lost": SimulationLostError("lost"),
    "missing": SimulationMissingError("missing"),
    "memory": OutOfMemoryError("none"),
    "no-memory": MemoryError("secret"),
    "unknown": UnknownModelError.at("model", "x", "y"),
    "teapot": HTTPException(418, "short", {"X-Tea": "yes"}),
    "failed": RuntimeError("secret"),
    "many": InvalidValueError(
        "many", [InvalidField(name, math.nan if name == "a" else 1, "z") for name in "abcde"]
    ),
    "none": InvalidValueError.at("a", None, "z"),
}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    from tests.service.samples import registry

    app: FastAPI = create_app(Settings(models_dir=tmp_path_factory.mktemp("m")), registry)

    async def fail(name: str) -> None:
        raise FAILURES[name]

    for path in ("/fail/{name}", "/v2/fail/{name}", "/v2x/fail/{name}"):
        app.get(path)(fail)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.mark.parametrize(
    ("name", "status", "slug", "again"),
    [
        ("slow", 408, "body-too-slow", False),
        ("full", 429, "queue-full", True),
        ("loading", 503, "not-ready", True),
        ("unavailable", 503, "model-unavailable", True),
        ("lost", 503, "simulation-lost", True),
        ("missing", 501, "simulation-not-installed", False),
        ("memory", 503, "out-of-memory", True),
        ("no-memory", 503, "out-of-memory", True),
        ("unknown", 404, "unknown-model", False),
        ("teapot", 418, "i'm-a-teapot", False),
        ("failed", 500, "internal-error", False),
    ],
)
def test_every_failure_has_its_status_and_says_whether_to_come_again(
    client, name, status, slug, again
):
    for root in ("", "/v2x"):
        answer = client.get(f"{root}/fail/{name}")
        problem = strict(answer.text)
        assert answer.status_code == problem["status"] == status
        assert problem["type"] == f"/problems/{slug}"
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.headers.get("retry-after") == ("1" if again else None)
        assert answer.headers["x-request-id"]
        assert "secret" not in answer.text
    by_protocol = client.get(f"/v2/fail/{name}")
    assert (by_protocol.status_code, list(by_protocol.json())) == (status, ["error"])
    assert by_protocol.headers["content-type"] == "application/json"


def test_a_refusal_of_the_framework_keeps_its_headers_and_names_the_route(client):
    answer = client.get("/fail/teapot")
    assert answer.headers["x-tea"] == "yes"
    assert answer.json()["detail"] == "GET /fail/teapot: short"
    assert answer.json()["title"] == "I'm a Teapot"


def test_the_protocol_has_one_text_and_400_for_wrong_values(client):
    answer = client.get("/v2/fail/many")
    assert answer.status_code == 400
    assert answer.json()["error"] == (
        "a is nan, expected z; b is 1, expected z; c is 1, expected z; d is 1, expected z"
    )
    assert client.get("/v2/fail/none").json()["error"] == "a is null, expected z"
    assert client.get("/v2/fail/loading").json()["error"] == "loading"


def test_a_parameter_of_the_path_is_named(client):
    problem = client.get("/models/dot/versions/x").json()
    assert (problem["status"], problem["field"], problem["value"]) == (422, "version", "x")


def test_refusals_are_counted_by_name(client):
    client.get("/fail/lost")
    assert (
        'rollcast_rejected_requests_total{reason="simulation-lost"}' in client.get("/metrics").text
    )
    assert isinstance(FAILURES["lost"], ServiceError)
