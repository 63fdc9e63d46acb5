"""What the fuzzer calls with any bytes: readers of input, and the whole app over them.

Each target returns when the input was read or refused with a problem document that is strict JSON,
and raises otherwise.
"""

import asyncio
import contextlib
import io
import json
import resource
import struct
import tempfile
import time
import tracemalloc
import urllib.parse
import warnings
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NoReturn

import httpx2
import numpy as np
from PIL import Image
from pydantic import ValidationError

from rollcast.client import Client
from rollcast.client.testing import FakeService
from rollcast.errors import RollcastError
from rollcast.manifest import Manifest
from rollcast.schemas import PredictRequest
from service.app import create_app
from service.auth.api_keys import Key, KeyFile, digest
from service.errors import ServiceError
from service.http.oip.schemas import InferRequest
from service.http.oip.tensors import read_query, split
from service.http.problem_details import document
from service.http.request_body import FILES, LISTS, parse_form, parse_json
from service.settings import Settings
from tests.service import samples

Target = Callable[[bytes], None]

LOOP = asyncio.new_event_loop()
SCRATCH = Path(tempfile.gettempdir()) / "rollcast-fuzz"
SCRATCH.mkdir(exist_ok=True)
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
LONGEST_REFUSAL = 8000
LONGEST_PAGE = 2**20
ASKED = [np.zeros((32, 32, 3), np.uint8)] * 4
"""Frames that a client sends."""
SETTINGS = Settings(models_dir=SCRATCH, max_body_bytes=2**20)


class SmallManifest(Manifest):
    """Of a model whose frames are so small that a fuzzer can write them."""

    @property
    def frames_shape(self) -> tuple[int, int, int, int]:
        return (1, 2, 2, 3)


SMALL = SmallManifest.model_validate(samples.manifest().model_dump())


def frames(data: bytes) -> None:
    """One image file."""
    with warnings.catch_warnings(), refusals():
        warnings.simplefilter("ignore")  # Pillow warns of damaged metadata and goes on
        decoded, _ = samples.decode_frames([with_checksums(data)], ["frames[0]"])
        assert (decoded.shape, decoded.dtype) == ((1, 128, 128, 3), np.uint8)


def multipart(data: bytes) -> None:
    """A content type, a line feed, a body."""
    kind, _, content = data.partition(b"\n")
    with refusals():
        request, _ = parse_form(
            content,
            kind.decode("latin-1"),
            PredictRequest,
            files=FILES,
            lists=LISTS,
            check=lambda: None,
        )
        assert len(request.frames) == 4


def tensors(data: bytes) -> None:
    """The length of the JSON, a line feed, the JSON, tensors."""
    announced, _, body = data.partition(b"\n")
    with refusals():
        text, binary = split(body, announced.decode("latin-1") if announced else None)
        query = read_query(parse_json(text, InferRequest), binary, SMALL, max_batch=4)
        assert query.frames.shape[1:] == SMALL.frames_shape
        assert 1 <= query.horizon <= 1000
        assert query.outputs


def manifest(data: bytes) -> None:
    """The file ``manifest.json``."""
    path = SCRATCH / "manifest.json"
    path.write_bytes(data)
    try:
        read = Manifest.read(path)
    except ValidationError as error:
        json.dumps(error.errors(include_url=False, include_input=False, include_context=False))
        return
    read.write(path)
    assert Manifest.read(path) == read
    assert set(read.step_output_names) <= set(read.output_names)


ROUTES = (
    ("/predict", b"application/json"),
    ("/predict", b"multipart/form-data; boundary=rollcast"),
    ("/predict/stream", b"application/json"),
    ("/v2/models/dot/infer", b"application/json"),
    ("/v2/models/dot/infer", b"application/octet-stream"),
    ("/simulate", b"application/json"),
)


class App:
    """The whole app with one fake model of each kind, in this process."""

    def __init__(self) -> None:
        self._app = create_app(SETTINGS, samples.registry)
        self._lifespan = self._app.router.lifespan_context(self._app)
        LOOP.run_until_complete(self._lifespan.__aenter__())
        while self._app.state.service.phase != "serving":
            LOOP.run_until_complete(asyncio.sleep(0.01))
        self._app.state.service.simulation.submit = _nothing_is_simulated

    def __call__(self, data: bytes) -> None:
        """Post a body; its first byte tells where, its second how long the JSON is said to be."""
        if len(data) < 2:
            return
        path, kind = ROUTES[data[0] % len(ROUTES)]
        headers = [(b"content-type", kind)]
        if kind == b"application/octet-stream":
            length = min(len(data), 4 * data[1])
            headers.append((b"inference-header-content-length", str(length).encode()))
        status, given, body = LOOP.run_until_complete(self._post(path, headers, data[2:]))
        assert 200 <= status < 500, f"{status} of {path}: {body[:500]!r}"
        if status != 200:
            assert b"json" in given[b"content-type"]
            assert len(body) < LONGEST_REFUSAL
            strict_json(body)
        elif given[b"content-type"].startswith(b"application/json"):
            strict_json(body)

    def head(self, data: bytes) -> None:
        """A method, a path with its query, headers: lines of a request's head, without a body."""
        first, *lines = data.replace(b"\r", b"").split(b"\n")
        method, _, target = first.partition(b" ")
        path, _, query = target.partition(b"?")
        headers = [(name.lower(), value) for name, _, value in (x.partition(b": ") for x in lines)]
        shown = urllib.parse.unquote(path.decode("latin-1"))
        status, _, body = LOOP.run_until_complete(
            self._post("/" + shown.lstrip("/"), headers, b"", method.decode("latin-1"), query)
        )
        assert 100 <= status < 500 or status == 503, f"{status} of {data[:200]!r}"
        assert len(body) < LONGEST_PAGE

    async def _post(
        self,
        path: str,
        headers: list[tuple[bytes, bytes]],
        body: bytes,
        method: str = "POST",
        query: bytes = b"",
    ) -> tuple[int, Mapping[bytes, bytes], bytes]:
        told: list[dict[str, Any]] = []
        left = [{"type": "http.request", "body": body, "more_body": False}]
        asked = asyncio.Event()

        async def receive() -> dict[str, Any]:
            if left:
                return left.pop()
            await asked.wait()
            return {"type": "http.disconnect"}

        async def send(message: dict[str, Any]) -> None:
            told.append(message)

        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": method,
            "scheme": "http",
            "path": path,
            "raw_path": path.encode("utf-8", "replace"),
            "query_string": query,
            "root_path": "",
            "headers": headers,
            "client": ("127.0.0.1", 1),
            "server": ("127.0.0.1", 80),
            "state": {},
        }
        await asyncio.wait_for(self._app(scope, receive, send), 20)
        start, *rest = told
        content = b"".join(message.get("body", b"") for message in rest)
        return start["status"], dict(start["headers"]), content


def _nothing_is_simulated(*_: object) -> Future[bytes]:
    done: Future[bytes] = Future()
    done.set_result(b"{}")
    return done


@contextlib.contextmanager
def refusals() -> Any:
    """Let a refusal pass whose problem document can be sent."""
    try:
        yield
    except ServiceError as error:
        text = document(error)
        assert len(text) < LONGEST_REFUSAL
        strict_json(text.encode("utf-8"))


def strict_json(body: bytes) -> object:
    """Parse JSON as strict clients do: no NaN, no infinities, no lone surrogates."""
    parsed = json.loads(body.decode("utf-8"), parse_constant=_refuse)
    json.dumps(parsed, ensure_ascii=False).encode("utf-8")
    return parsed


def _refuse(name: str) -> NoReturn:
    raise AssertionError(f"{name} is no JSON")


def with_checksums(data: bytes) -> bytes:
    """Repair the checksums of a PNG's chunks: else no change would get past them."""
    if not data.startswith(PNG_SIGNATURE):
        return data
    repaired, place = bytearray(data), len(PNG_SIGNATURE)
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        end = place + 8 + length
        if end + 4 > len(data):
            break
        struct.pack_into(">I", repaired, end, zlib.crc32(data[place + 4 : end]))
        place = end + 4
    return bytes(repaired)


def keys(data: bytes) -> None:
    """The file of API keys."""
    path = SCRATCH / "keys.json"
    path.write_bytes(data)
    with contextlib.suppress(ValueError):
        KeyFile.read(path)


def answer(data: bytes) -> None:
    """An answer to the client: its first byte chooses the call, its second the status."""
    if len(data) < 2:
        return
    statuses = (200, 422, 503)

    def answered(_: httpx2.Request) -> httpx2.Response:
        return httpx2.Response(statuses[data[1] % len(statuses)], content=data[2:])

    with Client("http://answers", transport=httpx2.MockTransport(answered), retries=0) as client:
        calls: tuple[Callable[[], object], ...] = (
            lambda: client.predict(ASKED, horizon=3),
            lambda: list(client.predict_stream(ASKED, horizon=3)),
            lambda: client.simulate("hemisphere", seed=1, steps=4),
            client.models,
            client.health,
        )
        with contextlib.suppress(RollcastError):
            calls[data[0] % len(calls)]()


class Cost:
    """What reading costs: the first byte of an input chooses the reader of the others.

    Fails when time or memory go beyond a fixed part and so much for every byte. ``worst`` has the
    worst of every reader: seconds and bytes, and those for each byte of an input, of which small
    ones count as KIBI.
    """

    ALLOWED_S, ALLOWED_S_PER_BYTE = 0.5, 50e-6
    ALLOWED_BYTES, ALLOWED_BYTES_PER_BYTE = 400 * 2**20, 200
    """The fixed part is what a frame of 4096 pixels takes, whatever its file weighs."""
    KIBI = 1024

    def __init__(self) -> None:
        app = App()
        self._readers: dict[str, Target] = {
            "frames": frames,
            "multipart": multipart,
            "tensors": tensors,
            "manifest": manifest,
            "app": app,
            "head": app.head,
            "keys": keys,
            "answer": answer,
        }
        for seed in seeds("cost"):  # what is imported and cached once is no input's cost
            self._reader(seed)(seed[1:])
        self.worst = {name: dict.fromkeys(COSTS, 0.0) for name in self._readers}
        tracemalloc.start()

    def __call__(self, data: bytes) -> None:
        """Read an input and measure."""
        if len(data) < 2:
            return
        read = self._reader(data)
        tracemalloc.reset_peak()
        before, resident = tracemalloc.get_traced_memory()[0], most_resident()
        began = time.process_time()
        read(data[1:])
        seconds = time.process_time() - began
        memory = max(tracemalloc.get_traced_memory()[1] - before, most_resident() - resident)
        assert seconds < self.ALLOWED_S + self.ALLOWED_S_PER_BYTE * len(data), seconds
        assert memory < self.ALLOWED_BYTES + self.ALLOWED_BYTES_PER_BYTE * len(data), memory
        size = max(len(data), self.KIBI)
        found = dict(zip(COSTS, (seconds, memory, seconds / size, memory / size), strict=True))
        name = _reader_of(data)
        worst = self.worst[name]
        if any(found[one] > worst[one] for one in COSTS):
            self.worst[name] = {one: max(found[one], worst[one]) for one in COSTS}

    def _reader(self, data: bytes) -> Target:
        return self._readers[_reader_of(data)]


def _reader_of(data: bytes) -> str:
    return COST_READERS[data[0] % len(COST_READERS)]


COSTS = ("seconds", "bytes", "seconds a byte", "bytes a byte")
COST_READERS = ("frames", "multipart", "tensors", "manifest", "app", "head", "keys", "answer")


def most_resident() -> int:
    """The most memory that this process has had, bytes: decoders in C are not traced."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


TARGETS: Mapping[str, Callable[[], Target]] = {
    "frames": lambda: frames,
    "multipart": lambda: multipart,
    "tensors": lambda: tensors,
    "manifest": lambda: manifest,
    "app": App,
    "answer": lambda: answer,
    "cost": Cost,
}


def _images() -> list[bytes]:
    picture = Image.fromarray(samples.dot(20, 12, 32))
    kinds = [("PNG", {}), ("JPEG", {}), ("WEBP", {}), ("WEBP", {"lossless": True})]
    plain = [samples.encode(picture, kind, **options) for kind, options in kinds]
    modes = [samples.encode(picture.convert(mode), "PNG") for mode in ("1", "L", "P", "LA", "RGBA")]
    exif = Image.Exif()
    exif[0x0112] = 6
    others = [
        samples.encode(Image.new("I;16", (32, 32), 9000), "PNG"),
        samples.encode(picture.convert("CMYK"), "JPEG"),
        samples.encode(picture, "JPEG", exif=exif, progressive=True),
        samples.encode(picture, "PNG", save_all=True, append_images=[picture.rotate(90)]),
        samples.encode(picture, "WEBP", save_all=True, append_images=[picture.rotate(90)]),
    ]
    return [*plain, *modes, *others]


def _multipart_bodies() -> list[bytes]:
    image = samples.png(samples.dot(20, 12, 32))
    part = b'--b\r\nContent-Disposition: form-data; name="%b"%b\r\n\r\n%b\r\n'
    four = b"".join(part % (b"frames", b'; filename="f.png"', image) for _ in range(4))
    text = part % (b"horizon", b"", b"3") + part % (b"frame_rate", b"", b"1e400")
    whole = [four + b"--b--\r\n", four + text + b"--b--\r\n", text + b"--b--", four, b"--b--"]
    return [b"multipart/form-data; boundary=b\n" + body for body in whole]


def _infer_bodies() -> list[bytes]:
    def message(**changes: object) -> bytes:
        tensor = {"name": "frames", "datatype": "UINT8", "shape": [1, 1, 2, 2, 3]} | changes
        horizon = {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [7]}
        return json.dumps({"id": "a", "inputs": [tensor, horizon]}).encode()

    flat, behind = message(data=[0] * 12), message(parameters={"binary_data_size": 12})
    nested = message(data=[[[[[1, 2, 3]] * 2] * 2]])
    wanted = json.dumps(
        {"inputs": [], "outputs": [{"name": "positions", "parameters": {"binary_data": True}}]}
    ).encode()
    announced = str(len(behind)).encode() + b"\n" + behind + bytes(12)
    return [b"\n" + flat, b"\n" + nested, announced, b"\n" + wanted]


def _answers() -> list[bytes]:
    """Answers to the calls of ``answer``, and a problem document."""
    fake, told = FakeService(), list[bytes]()

    def answered(request: httpx2.Request) -> httpx2.Response:
        response = fake.handler(request)
        assert isinstance(response, httpx2.Response)
        told.append(response.read())
        return response

    with Client("http://answers", transport=httpx2.MockTransport(answered)) as client:
        client.predict(ASKED, horizon=3)
        list(client.predict_stream(ASKED, horizon=3))
        client.simulate("hemisphere", seed=1, steps=4)
        client.models()
        client.health()
    return told


def seeds(target: str) -> list[bytes]:
    """Inputs that the fuzzer begins with."""
    match target:
        case "frames":
            return _images()
        case "multipart":
            return _multipart_bodies()
        case "tensors":
            return _infer_bodies()
        case "manifest":
            return [
                samples.manifest().model_dump_json().encode(),
                samples.manifest(covariance=samples.EMPIRICAL).model_dump_json().encode(),
                samples.manifest(frames=5, final_step=9).model_dump_json().encode(),
            ]
        case "cost":
            return [
                bytes([index]) + seed
                for index, name in enumerate(COST_READERS)
                for seed in seeds(name)
            ]
        case "head":
            return [
                b"GET /models?sort=a&a=b HTTP/1.1\nHost: a\nAuthorization: Bearer rollcast_abc",
                b"GET /models/dot/versions/1\nX-Request-ID: abc\nAccept: text/html,*/*;q=0.8",
                b"POST /predict\nContent-Type: multipart/form-data; boundary=b\nContent-Length: 9",
                b"POST /predict\nContent-Type: application/json\nX-Request-Timeout-Ms: 1000",
                b"OPTIONS /predict\nOrigin: http://a\nAccess-Control-Request-Method: POST",
                b'GET /static/main.js\nCookie: a=b; c=d\nIf-None-Match: "a"\nRange: bytes=0-9',
                b"POST /v2/models/dot/infer\nInference-Header-Content-Length: 12",
                b"GET /v2/models/%F0%9F%8E%B1/ready\nX-Forwarded-For: 1.2.3.4, 5.6.7.8",
            ]
        case "keys":
            key = Key(name="robot", sha256=digest("a"), scopes=("forecast",))
            return [KeyFile(keys=(key,)).model_dump_json().encode(), b'{"keys": [{}]}']
        case "answer":
            return [bytes([call, 0]) + body for call, body in enumerate(_answers())]
        case _:
            predict = json.dumps(samples.body(horizon=2)).encode()
            simulate = b'{"scenario": "hemisphere", "seed": 7, "scene": {"radius_m": 0.1}}'
            form = _multipart_bodies()[1].partition(b"\n")[2].replace(b"--b", b"--rollcast")
            infer = _infer_bodies()[0].strip()
            bodies = (predict, form, predict, infer, infer, simulate)
            return [bytes([route, 50]) + body for route, body in enumerate(bodies)]


WORDS = (
    b"IHDR", b"IDAT", b"IEND", b"PLTE", b"tRNS", b"iCCP", b"eXIf", b"acTL", b"fcTL", b"fdAT",
    b"\xff\xd8\xff", b"\xff\xda", b"\xff\xc2", b"\xff\xee", b"WEBP", b"VP8L", b"VP8X", b"ANMF",
    b"NaN", b"Infinity", b"-Infinity", b"1e400", b"\\ud800", b"\\udfff", b"null", b"true",
    b"[[[[[", b"frames", b"horizon", b"inputs", b"outputs", b"parameters", b"binary_data_size",
    b"binary_data", b"shape", b"datatype", b"UINT8", b"INT64", b"FP32", b"data", b"-1",
    b"18446744073709551616", b"final_frame", b"frame_rate", b"scenario",
    b"model", b"num_objects", b"filename*=", b"Content-Disposition: form-data; name=", b"boundary=",
    b"charset=", b"Content-Type: ", b"covariance", b"empirical", b"variance_scale",
    b"golden_tolerance", b"format_version",
)  # fmt: skip


def dictionary() -> str:
    """Words that the fuzzer may put in, in libFuzzer's form."""
    lines = io.StringIO()
    for word in WORDS:
        lines.write('"' + "".join(f"\\x{byte:02x}" for byte in word) + '"\n')
    return lines.getvalue()
