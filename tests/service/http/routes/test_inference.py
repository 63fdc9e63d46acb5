"""The Open Inference Protocol: what /predict forecasts, as tensors, in batches, to the bit."""

import json
import threading
import time

import numpy as np
import pytest

from tests.service import samples
from tests.service.samples import EMPIRICAL, body, dot, png, served

LENGTH = "inference-header-content-length"
OCTETS = "application/octet-stream"
BATCH = np.stack(
    [
        [dot(x + index * dx, 60 + index, 128) for index in range(4)]
        for x, dx in ((40, 2), (50.3, 1.7), (70, -3))
    ]
)
ONE = BATCH[:1]
FINAL = np.stack([dot(40 + 2 * index, 60 + index) for index in range(5)])[None]


def tensor(name: str, array: np.ndarray, nested: bool = True) -> dict[str, object]:
    """A tensor whose numbers stand in the JSON."""
    datatype = {"uint8": "UINT8", "int64": "INT64", "float32": "FP32"}[array.dtype.name]
    data = array.tolist() if nested else array.ravel().tolist()
    return {"name": name, "datatype": datatype, "shape": list(array.shape), "data": data}


def frames_and_horizon(frames=ONE, horizon: int | None = 3) -> list[tuple[str, np.ndarray]]:
    given = [("frames", frames)]
    return given if horizon is None else [*given, ("horizon", np.array([horizon]))]


def as_json(frames=ONE, horizon: int | None = 3, nested: bool = True, **fields: object):
    inputs = [tensor(name, array, nested) for name, array in frames_and_horizon(frames, horizon)]
    return {"json": {"inputs": inputs, **fields}}


def as_binary(frames=ONE, horizon: int | None = 3, tail: bytes = b"", **fields: object):
    given = frames_and_horizon(frames, horizon)
    inputs = [tensor(name, array[:0]) for name, array in given]
    for described, (_, array) in zip(inputs, given, strict=True):
        del described["data"]
        described["shape"] = list(array.shape)
        described["parameters"] = {"binary_data_size": array.nbytes}
    return behind({"inputs": inputs, **fields}, b"".join(a.tobytes() for _, a in given) + tail)


def behind(message: object, binary: bytes, length: object = None) -> dict[str, object]:
    text = json.dumps(message).encode()
    headers = {LENGTH: str(len(text) if length is None else length), "content-type": OCTETS}
    return {"content": text + binary, "headers": headers}


def raw(text: str | bytes) -> dict[str, object]:
    return {"content": text, "headers": {"content-type": "application/json"}}


def with_frames(**changes: object) -> dict[str, object]:
    """A request whose frames are described otherwise; what is None is left out."""
    described = tensor("frames", ONE, nested=False) | changes
    kept = {name: value for name, value in described.items() if value is not None}
    return {"json": {"inputs": [kept]}}


def infer(client, request, model: str = "dot"):
    return client.post(f"/v2/models/{model}/infer", **request)


def outputs_of(response) -> dict[str, np.ndarray]:
    """Read an answer as a client of the protocol does."""
    assert response.status_code == 200, response.text
    length = response.headers.get(LENGTH)
    if length is None:
        assert response.headers["content-type"] == "application/json"
        message, rest = response.json(), b""
    else:
        assert response.headers["content-type"] == OCTETS
        message = json.loads(response.content[: int(length)])
        rest = response.content[int(length) :]
    outputs = {}
    for output in message["outputs"]:
        assert output["datatype"] == "FP32"
        if "data" in output:
            values = np.array(output["data"]).astype(np.float32)
            assert "parameters" not in output
        else:
            size = output["parameters"]["binary_data_size"]
            values, rest = np.frombuffer(rest[:size], "<f4"), rest[size:]
        outputs[output["name"]] = values.reshape(output["shape"])
    assert rest == b""
    return outputs


def assert_same(left: dict[str, np.ndarray], right: dict[str, np.ndarray]) -> None:
    assert list(left) == list(right)
    for name, values in left.items():
        np.testing.assert_array_equal(values, right[name], err_msg=name, strict=True)


def test_the_server_describes_itself(client):
    assert client.get("/v2").json() == {
        "name": "rollcast",
        "version": "1.0",
        "extensions": ["binary_tensor_data", "model_repository"],
    }


@pytest.mark.parametrize("path", ["/v2/models/dot", "/v2/models/dot/versions/2"])
def test_a_model_describes_its_tensors(client, path):
    assert client.get(path).json() == {
        "name": "dot",
        "versions": ["1", "2"],
        "platform": "onnxruntime_onnx",
        "inputs": [
            {"name": "frames", "datatype": "UINT8", "shape": [-1, 4, 128, 128, 3]},
            {"name": "horizon", "datatype": "INT64", "shape": [1]},
        ],
        "outputs": [
            {"name": "positions", "datatype": "FP32", "shape": [-1, 1, -1, 2]},
            {"name": "covariances", "datatype": "FP32", "shape": [-1, 1, -1, 2, 2]},
            {"name": "angular_velocities", "datatype": "FP32", "shape": [-1, 1, -1, 3]},
        ],
    }


def test_a_model_with_a_final_frame_describes_its_own_tensors(client):
    described = client.get("/v2/models/between").json()
    assert described["inputs"][0]["shape"] == [-1, 5, 128, 128, 3]
    assert described["outputs"][-1] == {
        "name": "final_positions",
        "datatype": "FP32",
        "shape": [-1, 1, 2],
    }
    names = [output["name"] for output in client.get("/v2/models/line").json()["outputs"]]
    assert names == ["positions", "covariances"], "it has no angular velocities"


def test_live_and_ready(client):
    assert client.get("/v2/health/live").json() == {"live": True}
    ready = client.get("/v2/health/ready")
    assert (ready.status_code, ready.json()) == (200, {"live": True, "ready": True})
    for path in ("/v2/models/dot/ready", "/v2/models/dot/versions/2/ready"):
        assert client.get(path).json() == {"name": "dot", "ready": True}


def test_neither_ready_nor_answering_while_loading(start):
    loaded = threading.Event()

    def load(folder):
        loaded.wait(30)
        return samples.registry(folder)

    client = start(load)
    try:
        ready = client.get("/v2/health/ready")
        assert (ready.status_code, ready.json()) == (503, {"live": True, "ready": False})
        assert client.get("/v2/health/live").status_code == 200
        for response in (client.get("/v2/models/dot/ready"), infer(client, as_json())):
            assert response.status_code == 503
            assert response.json() == {"error": "The service is loading."}
            assert response.headers["retry-after"] == "1"
    finally:
        loaded.set()


@pytest.mark.parametrize("path", ["", "/ready", "/infer"])
@pytest.mark.parametrize(
    ("model", "status", "words"),
    [
        ("nope", 404, "model is nope, expected one of between@1, "),
        ("dot/versions/9", 404, "model is dot@9, expected one of dot@1, dot@2"),
        ("dot/versions/x", 404, "expected a version that is a whole number"),
        (f"dot/versions/{'1' * 5000}", 404, "expected a version that is a whole number"),
        ("%ED%A0%80", 404, "expected one of "),
        ("broken/versions/1", 503, "broken@1 is invalid: manifest.json is missing"),
    ],
)
def test_models_that_are_not_there(client, path, model, status, words):
    url = f"/v2/models/{model}{path}"
    response = client.post(url, **as_json()) if path == "/infer" else client.get(url)
    assert response.status_code == status
    assert words in only_error(response)


def only_error(response) -> str:
    assert response.headers["content-type"] == "application/json"
    (name,) = answer = response.json()
    assert name == "error"
    return answer["error"]


def test_positions_are_those_of_a_straight_line(client):
    response = infer(client, as_json(id="first"))
    answer = response.json()
    outputs = outputs_of(response)
    assert (answer["id"], answer["model_name"], answer["model_version"]) == ("first", "dot", "1")
    assert list(outputs) == ["positions", "covariances", "angular_velocities"]
    np.testing.assert_array_equal(outputs["positions"], [[[[46, 63], [48, 64], [50, 65]]]])
    np.testing.assert_array_equal(outputs["covariances"], np.eye(2) * np.ones((1, 1, 3, 1, 1)))
    assert outputs["angular_velocities"].shape == (1, 1, 3, 3)
    assert "id" not in infer(client, as_json()).json()


@pytest.mark.parametrize("model", ["dot", "line", "pair", "dot/versions/2"])
@pytest.mark.parametrize("rows", [1, 3])
def test_every_way_in_and_out_agrees_to_the_bit(client, model, rows):
    frames = BATCH[:rows]
    wanted = outputs_of(infer(client, as_json(frames), model))
    assert all(len(values) == rows for values in wanted.values())
    out = {"binary_data_output": True}
    for request in (
        as_json(frames, nested=False),
        as_binary(frames),
        as_json(frames, parameters=out),
        as_binary(frames, parameters=out),
    ):
        assert_same(outputs_of(infer(client, request, model)), wanted)


def test_each_row_of_a_batch_is_answered_as_alone(client):
    together = outputs_of(infer(client, as_binary(BATCH, 20), "pair"))
    for row in range(3):
        alone = outputs_of(infer(client, as_binary(BATCH[row : row + 1], 20), "pair"))
        assert_same(alone, {name: values[row : row + 1] for name, values in together.items()})


@pytest.mark.parametrize("model", ["dot", "line", "pair"])
def test_it_agrees_with_predict_to_the_bit(client, model):
    images = [png(frame) for frame in BATCH[1]]
    objects = client.post("/predict", json=body(images, model=model, horizon=7)).json()["objects"]
    outputs = outputs_of(infer(client, as_binary(BATCH[1:2], 7), model))
    for name, values in outputs.items():
        by_predict = np.array([[ball[name] for ball in objects]]).astype(np.float32)
        np.testing.assert_array_equal(values, by_predict, strict=True)
    assert ("angular_velocities" in outputs) == (model != "line")


def test_a_variance_scale_is_applied(start):
    covariance = {"source": "predicted", "variance_scale": [1, 4]}
    client = started(start, served(covariance=covariance))
    covariances = outputs_of(infer(client, as_binary()))["covariances"]
    np.testing.assert_array_equal(covariances[0, 0, :, 0, 0], [1, 4, 4])


def test_what_other_clients_add_changes_nothing(client):
    """KServe's names the model once more, a generated one makes every number a float."""
    plain = outputs_of(infer(client, as_json()))
    for request in (as_json(model_name="dot"), as_json(ONE.astype(np.float32))):
        for described in request["json"]["inputs"]:
            described["datatype"] = described["datatype"].replace("FP32", "UINT8")
        found = outputs_of(infer(client, request))
        np.testing.assert_array_equal(found["positions"], plain["positions"])


def test_a_final_frame_fixes_the_horizon(client):
    by_default = outputs_of(infer(client, as_binary(FINAL, None), "between"))
    assert by_default["positions"].shape == (1, 1, 10, 2)
    np.testing.assert_array_equal(by_default["final_positions"], [[[48, 64]]])
    assert_same(outputs_of(infer(client, as_json(FINAL, 10), "between")), by_default)
    refused = infer(client, as_json(FINAL, 9), "between")
    assert refused.status_code == 400
    assert (
        only_error(refused)
        == "horizon is 9, expected 10: the final frame of between@1 shows step 9"
    )


def test_the_horizon_is_the_trained_one_by_default(client):
    outputs = outputs_of(infer(client, as_binary(horizon=None)))
    assert outputs["positions"].shape == (1, 1, 20, 2)
    assert outputs_of(infer(client, as_binary(horizon=1000)))["positions"].shape[2] == 1000


def test_requested_outputs_come_in_their_order_each_in_its_way(client):
    whole = outputs_of(infer(client, as_binary()))
    names = ["covariances", "positions"]
    asked = [{"name": name} for name in names]
    outputs = outputs_of(infer(client, as_binary(outputs=asked)))
    assert_same(outputs, {name: whole[name] for name in names})

    asked[1]["parameters"] = {"binary_data": False}
    response = infer(client, as_json(outputs=asked, parameters={"binary_data_output": True}, id=""))
    assert_same(outputs_of(response), {name: whole[name] for name in names})
    message = json.loads(response.content[: int(response.headers[LENGTH])])
    assert message["id"] == ""
    assert message["outputs"][0]["parameters"] == {"binary_data_size": 48}
    assert message["outputs"][1]["data"] == [46, 63, 48, 64, 50, 65]


FRAMES = tensor("frames", ONE, nested=False)
HORIZON = tensor("horizon", np.array([3]))
SIZE = ONE.nbytes
FRAMES_DATA = FRAMES["data"]
HEAD = '{"inputs": [{"name": "frames", "datatype": "UINT8", "shape": [1, 4, 128, 128, 3], "data": '


def with_horizon(text: str) -> dict[str, object]:
    """Good frames, and a horizon that is written as it stands."""
    horizon = f'{{"name": "horizon", "datatype": "INT64", "shape": [1], "data": [{text}]}}'
    return raw(f"{HEAD}{json.dumps(FRAMES_DATA)}}}, {horizon}]}}")


REFUSED = {
    "not JSON": (raw("{"), "The body is not JSON"),
    "empty": (raw(""), "The body is not JSON"),
    "not UTF-8": (raw(b'{"id": "\xff"}'), "The body is not JSON"),
    "a list": (raw("[]"), "body is [], expected an object"),
    "nested deeply": (raw("[" * 100_000), "recursion limit exceeded"),
    "data nested deeply": (
        raw(f"{HEAD}{'[' * 500}1{']' * 500}}}]}}"),
        "recursion limit exceeded",
    ),
    "NaN": (with_horizon("NaN"), "The body is not JSON"),
    "infinity": (with_horizon("Infinity"), "The body is not JSON"),
    "1e400": (with_horizon("1e400"), "inputs[1].data is inf, expected whole numbers"),
    "2^64": (with_horizon(str(2**64)), f"inputs[1].data is {2**64}, expected whole numbers"),
    "five thousand digits": (with_horizon("1" * 5000), "The body is not JSON"),
    "half a step": (with_horizon("1.5"), "inputs[1].data is 1.5, expected whole numbers"),
    "another name": (
        as_json(model_name="line"),
        "model_name is line, expected dot, the name in the path",
    ),
    "null": (with_horizon("null"), "inputs[1].data is null, expected whole numbers"),
    "true": (with_horizon("true"), "inputs[1].data is true, expected whole numbers"),
    "in words": (with_horizon('"40"'), "inputs[1].data is 40, expected whole numbers"),
    "two horizons": (with_horizon("1, 2"), "inputs[1].data is [1, 2], expected 1 numbers"),
    "horizon 0": (with_horizon("0"), "horizon is 0, expected 1 to 1000"),
    "horizon 1001": (as_binary(horizon=1001), "horizon is 1001, expected 1 to 1000"),
    "a lone surrogate": (raw(r'{"id": "\ud800"}'), "The body is not JSON"),
    "an id that is no text": (as_json(id=7), "id is 7, expected a valid string"),
    "no inputs": (raw("{}"), "inputs is null, expected a value, the field is required"),
    "empty inputs": (raw('{"inputs": []}'), "inputs is empty, expected frames among them"),
    "nine inputs": (
        {"json": {"inputs": [HORIZON] * 9}},
        "inputs is 9 items, expected at most 8 items",
    ),
    "no frames": (
        {"json": {"inputs": [HORIZON]}},
        "inputs is horizon, expected frames among them",
    ),
    "frames twice": ({"json": {"inputs": [FRAMES] * 2}}, "inputs[1].name is frames, expected ever"),
    "unknown input": (
        with_frames(name="images"),
        "inputs[0].name is images, expected one of frames, horizon",
    ),
    "megabytes of a name": (with_frames(name="x" * 10**6), "more characters), expected one of"),
    "unknown field": (as_json(colour="red"), "colour is red, expected no such field"),
    "a thousand unknown fields": (
        as_json(**{f"field{index}": 1 for index in range(900)}),
        "field1 is 1, expected no such field; field2 is 1",
    ),
    "unknown parameter": (
        as_json(parameters={"priority": 1}),
        "parameters.priority is 1, expected no such field",
    ),
    "parameter of a wrong kind": (
        as_json(parameters={"binary_data_output": "yes"}),
        "parameters.binary_data_output is yes, expected a valid boolean",
    ),
    "no datatype": (with_frames(datatype=None), "inputs[0].datatype is null, expected a value"),
    "wrong datatype": (with_frames(datatype="FP32"), "inputs[0].datatype is FP32, expected UINT8"),
    "wrong shape": (
        with_frames(shape=[1, 4, 64, 64, 3]),
        "inputs[0].shape is [1, 4, 64, 64, 3], expected [-1, 4, 128, 128, 3], the first axis 1 to",
    ),
    "five frames": (with_frames(shape=[1, 5, 128, 128, 3]), "inputs[0].shape is [1, 5, "),
    "no batch axis": (with_frames(shape=[4, 128, 128, 3]), "inputs[0].shape is [4, 128, 128, 3]"),
    "a shape that is free": (with_frames(shape=[-1, 4, 128, 128, 3]), "inputs[0].shape is [-1, "),
    "an empty batch": (with_frames(shape=[0, 4, 128, 128, 3], data=[]), "inputs[0].shape is [0,"),
    "half an axis": (with_frames(shape=[1.5, 4, 128, 128, 3]), "inputs[0].shape[0] is 1.5"),
    "a huge batch": (with_frames(shape=[10**30, 4, 128, 128, 3]), "inputs[0].shape is [1000000"),
    "too large a batch": (
        as_binary(ONE.repeat(4, axis=0)),
        "inputs[0].shape is [4, 4, 128, 128, 3], expected [-1, 4, 128, 128, 3], the first axis "
        "1 to 3, for frames",
    ),
    "a number too few": (with_frames(data=FRAMES_DATA[1:]), "inputs[0].data is 196607 items"),
    "ragged": (with_frames(data=ONE.tolist()[0]), "inputs[0].data is 4 items"),
    "lists among numbers": (with_frames(data=[*FRAMES_DATA[1:], [0]]), "inputs[0].data is [0], "),
    "numbers among lists": (with_frames(data=[[1], 2]), "inputs[0].data is 2 items"),
    "a number for data": (with_frames(data=1), "inputs[0].data is 1, expected a valid list"),
    "256": (
        with_frames(data=[*FRAMES_DATA[1:], 256]),
        "inputs[0].data is 256, expected whole numbers, 0 to 255",
    ),
    "-1": (with_frames(data=[-1, *FRAMES_DATA[1:]]), "inputs[0].data is -1, expected whole num"),
    "no data": (with_frames(data=None), "inputs[0].data is null, expected numbers, or parameters."),
    "data twice": (
        with_frames(parameters={"binary_data_size": SIZE}),
        "inputs[0].data is 196608 items, expected no data beside parameters.binary_data_size",
    ),
    "a wrong size": (
        with_frames(parameters={"binary_data_size": 7}, data=None),
        f"inputs[0].parameters.binary_data_size is 7, expected {SIZE}, for UINT8 [1, 4, 128,",
    ),
    "a negative size": (
        with_frames(parameters={"binary_data_size": -1}, data=None),
        "inputs[0].parameters.binary_data_size is -1, expected greater than or equal to 0",
    ),
    "nothing behind the JSON": (
        with_frames(parameters={"binary_data_size": SIZE}, data=None),
        "expected at most the 0 bytes that remain after the JSON (Inference-Header-Content-Le",
    ),
    "bytes too many": (
        as_binary(tail=b"x"),
        f"body is {SIZE + 9} bytes after the JSON, expected {SIZE + 8} bytes after the JSON",
    ),
    "binary without the header": (raw(as_binary()["content"]), "The body is not"),
    "a length beyond the body": (behind({}, b"", 3), "is 3, expected the length of the JSON, at m"),
    "a length in words": (behind({}, b"", "two"), "Inference-Header-Content-Length is two, expect"),
    "a negative length": (behind({}, b"", -2), "Inference-Header-Content-Length is -2, expected"),
    "a length of many digits": (behind({}, b"", "9" * 5000), "more characters), expected the leng"),
    "a length within the JSON": (behind({"inputs": []}, b"", 5), "The body is not JSON"),
    "unknown output": (
        as_json(outputs=[{"name": "positions"}, {"name": "final_positions"}]),
        "outputs[1].name is final_positions, expected one of positions, covariances, angular_vel",
    ),
    "an output twice": (
        as_json(outputs=[{"name": "positions"}] * 2),
        "outputs[1].name is positions, expected every output once",
    ),
    "outputs of a wrong kind": (as_json(outputs="positions"), "outputs is positions, expected a v"),
}


@pytest.fixture(scope="module")
def strict_client(tmp_path_factory):
    from starlette.testclient import TestClient

    from service.app import create_app
    from service.settings import Settings

    folder = tmp_path_factory.mktemp("models")
    settings = Settings(models_dir=folder, max_batch=3, max_body_bytes=2_000_000)
    app = create_app(settings, samples.registry)
    with TestClient(app, raise_server_exceptions=False) as client:
        while client.get("/v2/health/ready").status_code != 200:
            time.sleep(0.01)
        yield client


@pytest.mark.parametrize("case", REFUSED)
def test_bad_requests_are_told_what_is_wrong(strict_client, case):
    request, words = REFUSED[case]
    started = time.perf_counter()
    response = infer(strict_client, request)
    elapsed = time.perf_counter() - started
    assert response.status_code == 400, response.text
    assert words in only_error(response)
    assert len(response.content) < 2000
    assert elapsed < 2, "a bad request must not keep the service busy"
    assert infer(strict_client, as_binary(horizon=1)).status_code == 200


def test_a_body_that_is_too_large(strict_client):
    response = infer(strict_client, {"content": bytes(2_000_001)})
    assert response.status_code == 413
    assert only_error(response) == "body is 2000001, expected at most 2000000 bytes"


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/v2/nowhere", 404),
        ("GET", "/v2/%ED%A0%80", 404),
        ("GET", "/v2/models/dot/infer", 405),
        ("POST", "/v2", 405),
    ],
)
def test_other_refusals_have_the_protocols_form_too(client, method, path, status):
    response = client.request(method, path)
    assert response.status_code == status
    assert only_error(response).startswith(f"{method} /v2")


def test_what_only_begins_alike_is_not_the_protocol(client):
    assert client.get("/v2x").headers["content-type"] == "application/problem+json"


def started(start, *models):
    client = start(lambda _: samples.Registry(models))
    while client.get("/v2/health/ready").status_code != 200:
        time.sleep(0.01)
    return client


class Slow(samples.DotPredictor):
    """Waits until it is told to go on."""

    def __init__(self, manifest):
        super().__init__(manifest)
        self.gate, self.entered = threading.Event(), threading.Semaphore(0)

    def encode(self, frames, *, two_cores=False):
        self.entered.release()
        self.gate.wait(30)
        return super().encode(frames, two_cores=two_cores)


def test_a_full_queue_is_429_with_retry_after(start):
    manifest = samples.manifest()
    slow = Slow(manifest)
    client = start(
        lambda _: samples.Registry([samples.Model("dot", 1, manifest, slow)]),
        inference_threads=1,
        inference_queue=0,
    )
    statuses = []
    first = threading.Thread(target=lambda: statuses.append(infer(client, as_binary()).status_code))
    first.start()
    try:
        assert slow.entered.acquire(timeout=30)
        refused = infer(client, as_binary())
        assert refused.status_code == 429
        assert refused.headers["retry-after"] == "1"
        assert "requests are being worked on" in only_error(refused)
    finally:
        slow.gate.set()
        first.join()
    assert statuses == [200]
    assert infer(client, as_binary()).status_code == 200


def test_a_forecast_past_its_deadline_is_given_up(start):
    manifest = samples.manifest()
    slow = Slow(manifest)
    client = started(start, samples.Model("dot", 1, manifest, slow))
    request = as_binary()
    hasty = {**request, "headers": request["headers"] | {"x-request-timeout-ms": "50"}}
    try:
        refused = infer(client, hasty)
        assert refused.status_code == 504
        assert only_error(refused) == "The answer was not there after 0.05 s."
    finally:
        slow.gate.set()
    assert infer(client, request).status_code == 200


class Failing(samples.DotPredictor):
    """Breaks, or leaves every bound at its second step."""

    def encode(self, frames, *, two_cores=False):
        if not frames.any():
            raise RuntimeError("secret path /root")
        return super().encode(frames, two_cores=two_cores)

    def step(self, state):
        return super().step({**state, "velocity": state["velocity"] * np.float32(np.inf)})


def test_a_fault_of_the_service_tells_nothing_of_its_inside(start):
    manifest = samples.manifest()
    client = started(start, samples.Model("dot", 1, manifest, Failing(manifest)))
    failed = infer(client, as_binary(np.zeros_like(ONE)))
    assert failed.status_code == 500
    assert only_error(failed) == "The service failed; its log contains the reason."
    diverged = infer(client, as_binary())
    assert diverged.status_code == 400
    assert only_error(diverged) == "horizon is 3, expected at most 1 for these frames"
    assert infer(client, as_binary(horizon=1)).status_code == 200


def test_numbers_beyond_fp32_are_refused(start):
    client = started(start, served(covariance=EMPIRICAL | {"empirical": [[[1e39, 0], [0, 1]]]}))
    refused = infer(client, as_binary())
    assert refused.status_code == 400
    assert only_error(refused).startswith("covariances is not finite, expected finite FP32 numbers")
    positions = as_binary(outputs=[{"name": "positions"}])
    assert infer(client, positions).status_code == 200
