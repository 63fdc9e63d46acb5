"""KServe's manifest has the fields of KServe's own description of its kinds, and their types."""

import re
from pathlib import Path
from typing import Any

import kserve
import pytest
import yaml

MANIFEST = Path(__file__).resolve().parents[2] / "docker" / "kubernetes" / "kserve.yaml"
KINDS = {
    "ServingRuntime": "V1alpha1ServingRuntime",
    "InferenceService": "V1beta1InferenceService",
}
PLAIN = {"str": str, "int": int, "bool": bool, "object": object}


def check(value: Any, kind: str, place: str) -> None:
    """Compare a value with a kind of KServe's description; those of Kubernetes are left out."""
    if inner := re.fullmatch(r"list\[(.+)\]", kind):
        assert isinstance(value, list), place
        for index, item in enumerate(value):
            check(item, inner.group(1), f"{place}[{index}]")
    elif kind in PLAIN:
        assert isinstance(value, PLAIN[kind]), f"{place} is {value!r}, expected {kind}"
    elif (model := getattr(kserve.models, kind, None)) is not None:
        types = {model.attribute_map[name]: of for name, of in model.openapi_types.items()}
        for name, item in value.items():
            assert name in types, f"{place}.{name} is not a field of {kind}"
            check(item, types[name], f"{place}.{name}")


def documents() -> list[Any]:
    return list(yaml.safe_load_all(MANIFEST.read_text()))


@pytest.mark.parametrize("kind", KINDS)
def test_the_manifest_has_kserves_fields(kind):
    (document,) = (one for one in documents() if one["kind"] == kind)
    check(document, KINDS[kind], kind)


def test_a_wrong_field_is_found():
    _, service = documents()
    service["spec"]["predictor"]["model"]["protocol"] = "v2"
    with pytest.raises(AssertionError, match=r"model\.protocol is not a field"):
        check(service, KINDS["InferenceService"], "InferenceService")


def test_the_service_asks_for_the_runtime_that_speaks_v2():
    runtime, service = documents()
    model = service["spec"]["predictor"]["model"]
    assert model["runtime"] == runtime["metadata"]["name"]
    assert model["protocolVersion"] in runtime["spec"]["protocolVersions"]
