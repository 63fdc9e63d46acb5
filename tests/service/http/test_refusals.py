"""Every bad request gets its own problem document, quickly, and the next request works."""

import gc
import gzip
import json
import time

import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient

from service.errors import ServiceError
from service.inference.deadlines import CancellationToken
from tests.service.samples import body, dot, encode, moving_dot, parts, png, png_header

GOOD = moving_dot()
BOMB = png_header(30_000, 30_000)


def raw(text: str | bytes) -> dict[str, object]:
    return {"content": text, "headers": {"content-type": "application/json"}}


def with_fields(**fields: object) -> dict[str, object]:
    return {"json": body(**fields)}


def with_images(*images: bytes) -> dict[str, object]:
    return {"json": body(list(images))}


def with_text(field: str, text: str) -> dict[str, object]:
    """A good body with one more field, written as it stands."""
    return raw(json.dumps(body())[:-1] + f', "{field}": {text}}}')


MALFORMED, INVALID = "malformed-body", "invalid-value"
PREDICT = {
    "not JSON": (raw("{"), 400, MALFORMED, None),
    "empty": (raw(""), 400, MALFORMED, None),
    "not UTF-8": (raw(b'{"model": "\xff"}'), 400, MALFORMED, None),
    "nested deeply": (raw("[" * 100_000), 400, MALFORMED, None),
    "NaN": (with_text("frame_rate", "NaN"), 400, MALFORMED, None),
    "infinity": (with_text("frame_rate", "-Infinity"), 400, MALFORMED, None),
    "1e400": (with_text("frame_rate", "1e400"), 422, INVALID, "frame_rate"),
    "1e400 steps": (with_text("horizon", "1e400"), 422, INVALID, "horizon"),
    "five thousand digits": (with_text("horizon", "1" * 5000), 400, MALFORMED, None),
    "lone surrogate in a value": (with_text("model", r'"a\ud800"'), 400, MALFORMED, None),
    "lone surrogate in a name": (with_text(r"\udfff", "1"), 400, MALFORMED, None),
    "frames as numbers": (raw('{"frames": ' + "[[7, 7, 7], " * 999 + "]"), 400, MALFORMED, None),
    "twenty thousand names": (
        raw("{" + ", ".join(f'"n{index % 19_999}": 1' for index in range(20_000)) + "}"),
        400,
        MALFORMED,
        None,
    ),
    "nine hundred unknown fields": (
        with_fields(**{f"{index:03d}{'x' * 1000}": "y" * 500 for index in range(900)}),
        422,
        INVALID,
        "000" + "x" * 97 + "... (903 more characters)",
    ),
    "compressed": (
        {
            "content": gzip.compress(json.dumps(body()).encode()),
            "headers": {"content-type": "application/json", "content-encoding": "gzip"},
        },
        415,
        "unsupported-media-type",
        "content-encoding",
    ),
    "a list": (raw("[]"), 422, INVALID, "body"),
    "unknown field": (with_fields(colour="red"), 422, INVALID, "colour"),
    "unknown model": (with_fields(model="nope"), 404, "unknown-model", "model"),
    "megabytes in a name": (with_fields(model="x" * 10**6), 404, "unknown-model", "model"),
    "a version of many digits": (
        with_fields(model=f"dot@{'1' * 5000}"),
        404,
        "unknown-model",
        "model",
    ),
    "three frames": (with_images(*GOOD[:3]), 422, INVALID, "frames"),
    "five frames": (with_images(*GOOD, GOOD[0]), 422, INVALID, "frames"),
    "no frames": (raw("{}"), 422, INVALID, "frames"),
    "not base64": (raw('{"frames": ["?", "?", "?", "?"]}'), 422, INVALID, "frames[0]"),
    "a number for a frame": (raw('{"frames": [1, 2, 3, 4]}'), 422, INVALID, "frames[0]"),
    "unequal sizes": (with_images(*GOOD[:3], png(dot(9, 9, 64))), 422, INVALID, "frames"),
    "not an image": (with_images(*GOOD[:3], b"hello"), 415, "not-an-image", "frames[3]"),
    "a GIF": (
        with_images(encode(Image.new("L", (64, 64)), "GIF"), *GOOD[:3]),
        415,
        "not-an-image",
        "frames[0]",
    ),
    "truncated": (with_images(*GOOD[:2], GOOD[2][:-40], GOOD[3]), 422, "broken-image", "frames[2]"),
    "a header alone": (with_images(GOOD[0][:30], *GOOD[1:]), 422, "broken-image", "frames[0]"),
    "a bomb": (with_images(*[BOMB] * 4), 422, INVALID, "frames[0]"),
    "not square": (
        with_images(*[png(np.zeros((64, 65, 3), np.uint8))] * 4),
        422,
        INVALID,
        "frames[0]",
    ),
    "too small": (with_images(*[png(dot(64, 64, 31))] * 4), 422, INVALID, "frames[0]"),
    "horizon 0": (with_fields(horizon=0), 422, INVALID, "horizon"),
    "horizon 1001": (with_fields(horizon=1001), 422, INVALID, "horizon"),
    "horizon in words": (with_fields(horizon="40"), 422, INVALID, "horizon"),
    "half a step": (with_fields(horizon=1.5), 422, INVALID, "horizon"),
    "a yes for a number": (with_fields(horizon=True), 422, INVALID, "horizon"),
    "no balls": (with_fields(num_objects=0), 422, INVALID, "num_objects"),
    "nine balls": (with_fields(num_objects=9), 422, INVALID, "num_objects"),
    "unknown scenario": (with_fields(scenario="moon"), 422, INVALID, "scenario"),
    "rate 0": (with_fields(frame_rate=0), 422, INVALID, "frame_rate"),
    "wrong content type": (
        {"content": b"x", "headers": {"content-type": "text/plain"}},
        415,
        "unsupported-media-type",
        "content-type",
    ),
    "no content type": ({"content": b"x"}, 415, "unsupported-media-type", "content-type"),
    "too large": ({"json": {"model": "x" * 3_000_000}}, 413, "body-too-large", "body"),
    "multipart without boundary": (
        {"content": b"x", "headers": {"content-type": "multipart/form-data"}},
        400,
        MALFORMED,
        None,
    ),
    "unknown part": ({"files": parts(GOOD), "data": {"colour": "red"}}, 422, INVALID, "colour"),
    "three parts": ({"files": parts(GOOD[:3])}, 422, INVALID, "frames"),
    "a part with brackets": (
        {"files": [("frames[]", ("a.png", GOOD[0]))]},
        422,
        INVALID,
        "frames[]",
    ),
    "a form without its last boundary": (
        {
            "content": b'--b\r\nContent-Disposition: form-data; name="model"\r\n\r\ndot\r\n',
            "headers": {"content-type": "multipart/form-data; boundary=b"},
        },
        400,
        MALFORMED,
        None,
    ),
    "a part without a name": (
        {
            "content": b"--b\r\nContent-Disposition: form-data\r\n\r\ndot\r\n--b--\r\n",
            "headers": {"content-type": "multipart/form-data; boundary=b"},
        },
        400,
        MALFORMED,
        None,
    ),
    "a part twice": (
        {"files": parts(GOOD), "data": {"horizon": ["1", "2"]}},
        422,
        INVALID,
        "horizon",
    ),
    "NaN in a part": (
        {"files": parts(GOOD), "data": {"frame_rate": "nan"}},
        422,
        INVALID,
        "frame_rate",
    ),
    "a hundred parts": ({"files": parts(GOOD * 25)}, 400, MALFORMED, None),
    "a long text part": (
        {"files": parts(GOOD), "data": {"model": "x" * 5000}},
        400,
        MALFORMED,
        "model",
    ),
}


@pytest.fixture
def client(start):
    client = start(max_body_bytes=2_000_000)
    while client.get("/health/ready").status_code != 200:
        time.sleep(0.01)
    return client


@pytest.mark.parametrize("case", PREDICT)
def test_bad_requests_to_predict(client, case):
    request, status, slug, field = PREDICT[case]
    started = time.perf_counter()
    response = client.post("/predict", **request)
    elapsed = time.perf_counter() - started
    problem = response.json()
    assert response.status_code == status, problem
    assert response.headers["content-type"] == "application/problem+json"
    assert problem["type"] == f"/problems/{slug}"
    assert problem["status"] == status
    assert problem["title"]
    assert problem["detail"]
    assert problem.get("field") == field
    assert len(response.content) < 8000
    assert elapsed < 2, "a bad request must not keep the service busy"
    assert client.post("/predict", json=body(GOOD, horizon=1)).status_code == 200


def test_the_problem_document_names_field_value_and_what_would_be_right(client):
    assert client.post("/predict", json=body(horizon=1001)).json() == {
        "type": "/problems/invalid-value",
        "title": "A value is invalid",
        "status": 422,
        "detail": "horizon: expected less than or equal to 1000",
        "field": "horizon",
        "value": 1001,
        "expected": "less than or equal to 1000",
    }


def test_an_answer_names_ten_mistakes_and_counts_the_others(client):
    problem = client.post("/predict", json={f"n{index}": 1 for index in range(50)}).json()
    assert len(problem["errors"]) == 10
    assert problem["detail"].startswith("51 values are invalid: frames, n0, n1")
    assert problem["detail"].endswith("n8 and 41 more")


@pytest.mark.parametrize("horizon", [3, 3.0])
def test_whole_numbers_may_have_a_point_in_json_as_in_forms(client, horizon):
    for request in (
        {"json": body(GOOD, horizon=horizon)},
        {"files": parts(GOOD), "data": {"horizon": str(horizon)}},
    ):
        answer = client.post("/predict", **request)
        assert answer.status_code == 200, answer.json()
        assert len(answer.json()["times_s"]) == 3


def test_files_of_a_form_need_no_file_name(client):
    head = b'--b\r\nContent-Disposition: form-data; name="frames"\r\n\r\n'
    form = b"".join(head + image + b"\r\n" for image in GOOD) + b"--b--\r\n"
    answer = client.post(
        "/predict", content=form, headers={"content-type": "multipart/form-data; boundary=b"}
    )
    assert answer.status_code == 200, answer.json()


def test_bracketed_parts_are_told_the_name(client):
    problem = client.post("/predict", files=[("frames[]", ("a.png", GOOD[0]))]).json()
    assert problem["expected"] == "the name 'frames', once for each file"


def test_the_bomb_is_told_by_its_size(client):
    problem = client.post("/predict", json=body([BOMB] * 4)).json()
    assert problem["value"] == "30000 x 30000"
    assert problem["expected"] == "a square of 32 to 4096 pixels a side"


def test_unequal_sizes_are_listed(client):
    problem = client.post("/predict", json=body([*GOOD[:3], png(dot(9, 9, 64))])).json()
    assert problem["value"] == "128 x 128, 128 x 128, 128 x 128, 64 x 64"


def test_every_wrong_field_is_listed(client):
    problem = client.post("/predict", json={"horizon": 0, "colour": 1}).json()
    assert problem["errors"] == [
        {"field": "frames", "value": None, "expected": "a value, the field is required"},
        {"field": "horizon", "value": 0, "expected": "greater than or equal to 1"},
        {"field": "colour", "value": 1, "expected": "no such field"},
    ]


def test_a_body_without_announced_length_is_cut_off_while_it_is_read(client):
    read = 0

    def chunks():
        nonlocal read
        for _ in range(1000):
            read += 100_000
            yield b"x" * 100_000

    response = client.post(
        "/predict", content=chunks(), headers={"content-type": "application/json"}
    )
    assert response.status_code == 413
    assert response.json()["expected"] == "at most 2000000 bytes"


@pytest.mark.parametrize(
    ("method", "path", "status", "slug"),
    [
        ("GET", "/nowhere", 404, "not-found"),
        ("GET", "/predict", 405, "method-not-allowed"),
        ("GET", "/models/nope", 404, "unknown-model"),
        ("GET", "/models/dot/versions/9", 404, "unknown-model"),
        ("GET", "/models/dot/versions/x", 422, "invalid-value"),
        ("GET", "/models/%ED%A0%80", 404, "unknown-model"),
        ("GET", "/%ED%A0%80", 404, "not-found"),
    ],
)
def test_other_routes_refuse_alike(client, method, path, status, slug):
    response = client.request(method, path)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["type"] == f"/problems/{slug}"


def test_a_fault_of_the_service_tells_nothing_of_its_inside(start):
    from tests.service.samples import registry, served

    model = served()

    class Failing(type(model.predictor)):
        def encode(self, frames, *, two_cores=False):
            raise RuntimeError("secret path /root")

    broken = type(model)("dot", 1, model.manifest, Failing(model.manifest))
    client = start(lambda _: type(registry(None))([broken]))
    response = client.post("/predict", json=body())
    assert response.status_code == 500
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json() == {
        "type": "/problems/internal-error",
        "title": "The service failed",
        "status": 500,
        "detail": "The service failed; its log contains the reason.",
    }


@pytest.mark.parametrize("path", ["/predict", "/predict/stream"])
@pytest.mark.parametrize(
    "request_", [raw('{"frames": ["?"]}'), raw("{"), {"files": parts(GOOD[:3])}], ids="vjm"
)
def test_what_was_refused_is_let_go(client, path, request_):
    """A body that lives on as long as the process would fill its memory, refusal by refusal."""

    def living() -> int:
        gc.collect()
        return sum(
            isinstance(thing, CancellationToken | ServiceError) for thing in gc.get_objects()
        )

    for _ in range(3):
        assert client.post(path, **request_).status_code >= 400
    before = living()
    for _ in range(10):
        client.post(path, **request_)
    # The server may not have let go of its last request yet when the answer is here.
    assert living() < before + 10


@pytest.mark.parametrize(
    "headers",
    [
        [("content-encoding", "identity"), ("content-encoding", "gzip")],
        [("content-encoding", "gzip, identity")],
        [("transfer-encoding", "gzip, chunked")],
        [("transfer-encoding", "gzip"), ("transfer-encoding", "chunked")],
    ],
    ids=str,
)
def test_a_body_with_any_encoding_is_refused(client, headers):
    headers = [("content-type", "application/json"), *headers]
    answer = client.post("/predict", content=b"{}", headers=headers)
    assert (answer.status_code, answer.json()["field"]) == (415, headers[-1][0])


@pytest.mark.parametrize("path", ["/nothing", "/models/none", "/predict", "/"])
def test_a_query_that_is_no_text_gets_an_answer(client, path):
    """Uvicorn refuses such bytes itself, other servers pass them on."""
    asked: dict[str, object] = {}

    class Server:
        """A server that puts the bytes into the query."""

        def __init__(self, app):
            self._app = app

        async def __call__(self, scope, receive, send):
            if scope["type"] == "http":
                scope["query_string"] = b"\xff\xfe"
                asked.update(scope)
            await self._app(scope, receive, send)

    answer = TestClient(Server(client.app), raise_server_exceptions=False).get(path)
    assert asked["query_string"] == b"\xff\xfe"
    assert answer.status_code in {200, 404, 405}


def test_a_byte_order_mark_is_passed_over(client):
    text = "\ufeff" + json.dumps(body(horizon=3))
    assert client.post("/predict", **raw(text.encode())).status_code == 200
