"""The smallest and largest numbers in every numeric field: an answer or a refusal, no failure."""

import json
from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest
from pydantic import BaseModel

from rollcast.schemas import DetectRequest, PredictRequest, SessionRequest, SimulateRequest
from service.http.oip.schemas import InferRequest
from tests.service.samples import body, moving_dot

EXTREMES = [5e-324, 1e-300, 1e300, 1.7e308, 10**400]
JSON = {"content-type": "application/json"}
ANY_BALL = {"model": "any-ball", "horizon": 3}


def variants(model: type[BaseModel], number: float) -> Iterator[tuple[str, Any]]:
    """Yield field and value for every numeric field, with valid values beside it."""
    schema = model.model_json_schema()
    yield from _variants(schema, schema.get("$defs", {}), number)


def _variants(
    schema: dict[str, Any], definitions: dict[str, Any], number: float
) -> Iterator[tuple[str, Any]]:
    schema = _resolved(schema, definitions)
    for choice in schema.get("anyOf", ()):
        yield from _variants(choice, definitions, number)
    if schema.get("type") in ("number", "integer"):
        yield "", number
    for name, field in schema.get("properties", {}).items():
        beside = {
            other: _filler(schema["properties"][other], definitions)
            for other in schema.get("required", ())
        }
        for path, value in _variants(field, definitions, number):
            yield f".{name}{path}", beside | {name: value}
    if "prefixItems" in schema:
        beside = [_filler(item, definitions) for item in schema["prefixItems"]]
        for index, item in enumerate(schema["prefixItems"]):
            for path, value in _variants(item, definitions, number):
                yield f"[{index}]{path}", [*beside[:index], value, *beside[index + 1 :]]
    elif isinstance(schema.get("items"), dict):
        for path, value in _variants(schema["items"], definitions, number):
            yield f"[0]{path}", [value]


def _filler(schema: dict[str, Any], definitions: dict[str, Any]) -> Any:
    schema = _resolved(schema, definitions)
    if "prefixItems" in schema:
        return [_filler(item, definitions) for item in schema["prefixItems"]]
    if schema.get("type") == "object":
        required = schema.get("required", ())
        return {name: _filler(schema["properties"][name], definitions) for name in required}
    return {"number": 0.1, "integer": 1}.get(schema.get("type", ""))


def _resolved(schema: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in schema:
        schema = definitions[schema["$ref"].rsplit("/", 1)[-1]]
    return schema


GOOD: dict[type[BaseModel], tuple[str, dict[str, Any]]] = {
    PredictRequest: ("/predict", body(moving_dot(128), **ANY_BALL)),
    DetectRequest: ("/detect", body(moving_dot(128), model="any-ball")),
    SimulateRequest: (
        "/simulate",
        {"scenario": "hemisphere", "seed": 7, "steps": 4, "include_frames": False},
    ),
}


@pytest.mark.parametrize("number", EXTREMES, ids=["denormal", "small", "large", "max", "integer"])
@pytest.mark.parametrize("model", GOOD, ids=lambda model: model.__name__)
def test_an_extreme_number_does_not_fail_the_service(client, model, number):
    path, good = GOOD[model]
    fields = set()
    for field, changed in variants(model, number):
        fields.add(field)
        changed = {k: v for k, v in changed.items() if v is not None}
        text = json.dumps(changed | {k: v for k, v in good.items() if k not in field.split(".")})
        if model is SimulateRequest and field.startswith(".scene."):
            text = json.dumps(good | {"scene": changed["scene"]})
        answer = client.post(path, content=text, headers=JSON)
        assert answer.status_code < 500, (field, number, answer.text)
    assert len(fields) >= (1 if model is DetectRequest else 6), "numeric fields are found"
    assert client.post(path, json=good).status_code == 200


@pytest.mark.parametrize("number", EXTREMES, ids=["denormal", "small", "large", "max", "integer"])
def test_an_extreme_number_does_not_fail_a_session(client, number):
    for field, changed in variants(SessionRequest, number):
        with client.websocket_connect("/stream") as session:
            session.send_text(json.dumps(changed))
            message = session.receive()
            assert "internal-error" not in message.get("text", ""), field
            assert message.get("code", 1000) != 1011, field


@pytest.mark.parametrize("path", ["/predict", "/predict/stream"])
@pytest.mark.parametrize("model", ["any-ball", "fieldnet"])
def test_the_lowest_and_highest_rates_and_horizons_are_answered_or_refused(client, path, model):
    for frame_rate, step_rate, horizon in product((1e-3, 1e5), (1e-3, 1e5), (1, 1000)):
        rates = {"frame_rate": frame_rate, "step_rate": step_rate, "horizon": horizon}
        answer = client.post(path, json=body(moving_dot(128), model=model, **rates))
        assert answer.status_code in (200, 422), (rates, answer.text)
        assert "event: error" not in answer.text, rates


@pytest.mark.parametrize("number", EXTREMES, ids=["denormal", "small", "large", "max", "integer"])
def test_an_extreme_number_does_not_fail_the_inference_protocol(client, number):
    frames = [0] * (4 * 128 * 128 * 3)
    good = [
        {"name": "frames", "datatype": "UINT8", "shape": [1, 4, 128, 128, 3], "data": frames},
        {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [3]},
        {"name": "balls", "datatype": "FP32", "shape": [1, 1, 2], "data": [60, 60]},
    ]
    for index, place in ((0, 7), (1, 0), (2, 0), (2, 1)):
        inputs = [dict(tensor, data=list(tensor["data"])) for tensor in good]
        inputs[index]["data"][place] = number
        answer = client.post("/v2/models/any-ball/infer", json={"inputs": inputs})
        assert answer.status_code == 400 or index == 2, (index, answer.text)
        assert answer.status_code < 500, (index, answer.text)
    for _, changed in variants(InferRequest, number):
        answer = client.post("/v2/models/any-ball/infer", content=json.dumps(changed), headers=JSON)
        assert answer.status_code < 500, (changed, answer.text)
