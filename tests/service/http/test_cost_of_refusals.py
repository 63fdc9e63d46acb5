"""What a refusal costs grows with the bytes that are refused, for every reader of a body.

Each reader is given the same kind of wrong input twice, the second four times as long. Processor
time and memory may grow by the same factor, and by the noise of a machine that does other things.
"""

import io
import json
import struct
import threading
import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress

import pytest
from PIL import Image

from rollcast.schemas import PredictRequest, SimulateRequest
from service.errors import ServiceError
from service.http.oip.schemas import InferRequest
from service.http.oip.tensors import read_query
from service.http.problem_details import document
from service.http.request_body import FILES, LISTS, parse_form, parse_json
from tests.service import samples
from tests.service.samples import decode_frames, dot, encode, png, png_chunk

FACTOR = 4
MAX_GROWTH = 2 * FACTOR
NEGLIGIBLE_S = 0.02
NEGLIGIBLE_BYTES = 200_000
MAX_BYTES_PER_BYTE = 100
"""Memory for each byte of an input: a list of one character's JSON has 56 bytes."""

Reader = Callable[[bytes], object]
LOOSE = 10**9
"""A number of values that no limit stops, to see what parsing itself costs."""


def predict(body: bytes) -> object:
    return parse_json(body, PredictRequest)


def simulate(body: bytes) -> object:
    return parse_json(body, SimulateRequest)


def infer(body: bytes) -> object:
    request = parse_json(body, InferRequest, LOOSE)
    return read_query(request, memoryview(b""), samples.manifest(), max_batch=16)


def form(body: bytes) -> object:
    return parse_form(
        body,
        "multipart/form-data; boundary=b",
        PredictRequest,
        files=FILES,
        lists=LISTS,
        check=lambda: None,
    )


def form_header(value: bytes) -> object:
    return parse_form(
        b"--b--",
        value.decode("latin-1"),
        PredictRequest,
        files=FILES,
        lists=LISTS,
        check=lambda: None,
    )


def frame(data: bytes) -> object:
    return decode_frames([data], ["frames[0]"])


def tensor(data: str) -> bytes:
    given = {"name": "frames", "datatype": "UINT8", "shape": [1, 4, 128, 128, 3], "data": 0}
    return json.dumps({"inputs": [given]}).replace('"data": 0', f'"data": {data}').encode()


def part(count: int, name: str = "model", content: bytes = b"x", more: bytes = b"") -> bytes:
    head = f'--b\r\nContent-Disposition: form-data; name="{name}"\r\n'.encode()
    return (head + more + b"\r\n" + content + b"\r\n") * count + b"--b--\r\n"


def jpeg(middle: bytes, side: int = 256) -> bytes:
    """A JPEG file with segments before its own."""
    image = encode(Image.fromarray(dot(60, 60, side)), "JPEG")
    return image[:2] + middle + image[2:]


def scans(count: int, side: int = 1024) -> bytes:
    """A progressive JPEG file whose last scan is repeated."""
    image = encode(Image.fromarray(dot(60, 60, side)), "JPEG", progressive=True)
    last = image[image.rindex(b"\xff\xda") : -2]
    return image[:-2] + last * count + b"\xff\xd9"


def segment(marker: int, content: bytes) -> bytes:
    return bytes([0xFF, marker]) + struct.pack(">H", len(content) + 2) + content


def chunks(kind: bytes, content: bytes, count: int, *, before: bool = True) -> bytes:
    """A PNG file with more chunks, before or behind its pixels."""
    image = png(dot(60, 60))
    place = 33 if before else len(image) - 12
    return image[:place] + png_chunk(kind, content) * count + image[place:]


def directory(count: int) -> bytes:
    """An EXIF block whose entries all name the same large value."""
    size = 12 * count
    head = b"Exif\0\0MM\0*\0\0\0\x08" + struct.pack(">H", min(count, 65535))
    return head + struct.pack(">HHII", 0x9286, 7, size, 8) * count + bytes(4)


def exif(count: int) -> bytes:
    return jpeg(b"".join(segment(0xE1, directory(5000)) for _ in range(count)))


CASES: dict[str, tuple[Reader, int, Callable[[int], bytes]]] = {
    "names": (predict, 50_000, lambda n: json.dumps({f"n{i}": 1 for i in range(n)}).encode()),
    "few names": (predict, 200, lambda n: json.dumps({f"n{i}": 1 for i in range(n)}).encode()),
    "a name twice": (
        predict,
        200,
        lambda n: b"{" + b",".join(b'"n%d":1' % (i % (n - 1)) for i in range(n)) + b"}",
    ),
    "long names": (
        predict,
        4000,
        lambda n: json.dumps({f"{i}" * n: 1 for i in range(99)}).encode(),
    ),
    "nesting": (predict, 500_000, lambda n: b"[" * n),
    "nested objects": (predict, 100_000, lambda n: b'{"a":' * n),
    "lists": (predict, 300_000, lambda n: b"[" + b"[]," * n + b"[]]"),
    "a long text": (predict, 2_000_000, lambda n: b'{"model": "' + b"x" * n + b'"}'),
    "escapes": (predict, 500_000, lambda n: b'{"model": "' + b"\\u00e9" * n + b'"}'),
    "digits": (predict, 1_000_000, lambda n: b'{"horizon": ' + b"1" * n + b"}"),
    "base64": (predict, 200_000, lambda n: json.dumps({"frames": ["AAAA" * n] * 4}).encode()),
    "no base64": (predict, 1_000_000, lambda n: json.dumps({"frames": ["?" * n] * 4}).encode()),
    "frames": (predict, 200, lambda n: json.dumps({"frames": ["?"] * n}).encode()),
    "velocities": (
        simulate,
        60,
        lambda n: json.dumps(
            {"scenario": "hemisphere", "seed": 1, "scene": {"velocities_m_s": [["a"] * 3] * n}}
        ).encode(),
    ),
    "unknown scene fields": (
        simulate,
        200,
        lambda n: json.dumps({"scene": {f"n{i}": 1 for i in range(n)}}).encode(),
    ),
    "empty lists in a tensor": (infer, 100_000, lambda n: tensor("[" + "[]," * n + "[]]")),
    "a flat tensor": (infer, 300_000, lambda n: tensor("[" + "7," * n + "7]")),
    "a tensor of texts": (infer, 100_000, lambda n: tensor("[" + '"a",' * n + "7]")),
    "wrong numbers": (infer, 49_000, lambda n: tensor("[" + "0.5," * (n - 1) + "7]")),
    "inputs": (infer, 50_000, lambda n: json.dumps({"inputs": [1] * n}).encode()),
    "axes": (
        infer,
        50_000,
        lambda n: json.dumps(
            {"inputs": [{"name": "frames", "datatype": "UINT8", "shape": [1] * n}]}
        ).encode(),
    ),
    "parts": (form, 10_000, part),
    "a long part": (form, 2_000_000, lambda n: part(1, "frames", b"x" * n)),
    "a long text part": (form, 2_000_000, lambda n: part(1, "model", b"x" * n)),
    "half boundaries": (form, 200_000, lambda n: part(1, "frames", b"\r\n--" * n)),
    "headers of a part": (form, 20_000, lambda n: part(1, more=b"a: b\r\n" * n)),
    "a long header of a part": (form, 500_000, lambda n: part(1, more=b"a: " + b"b" * n + b"\r\n")),
    "before the first part": (form, 500_000, lambda n: b"\r\n" * n + part(1)),
    "behind the last part": (form, 500_000, lambda n: part(1) + b"\r\n" * n),
    "options of the content type": (
        form_header,
        4000,
        lambda n: b"multipart/form-data" + b"; a=b" * n,
    ),
    "quotes in the content type": (
        form_header,
        8000,
        lambda n: b'multipart/form-data; boundary="' + b'\\"' * n,
    ),
    "no image": (frame, 2_000_000, bytes),
    "scans": (frame, 300, scans),
    "few scans": (frame, 5, scans),
    "empty segments": (frame, 100_000, lambda n: jpeg(segment(0xFE, b"") * n)),
    "fill bytes": (frame, 500_000, lambda n: jpeg(b"\xff" * n)),
    "profiles": (
        frame,
        20,
        lambda n: jpeg(segment(0xE2, b"ICC_PROFILE\0" + bytes(65_000)) * n),
    ),
    "EXIF blocks": (frame, 10, exif),
    "EXIF entries": (frame, 1000, lambda n: chunks(b"eXIf", directory(n)[6:], 1)),
    "chunks of text": (frame, 20_000, lambda n: chunks(b"tEXt", b"a\0b", n)),
    "chunks of text behind": (frame, 20_000, lambda n: chunks(b"tEXt", b"a\0b", n, before=False)),
    "unknown chunks": (frame, 20_000, lambda n: chunks(b"abCd", b"", n)),
    "empty pixels": (frame, 20_000, lambda n: chunks(b"IDAT", b"", n)),
    "pixels": (frame, 256, lambda n: encode(Image.new("RGB", (n * 2, n * 2)), "PNG")),
}


def cost(read: Reader, data: bytes) -> tuple[float, int]:
    """Seconds of the processor, the least of three runs, and bytes of memory of one more."""

    def once() -> float:
        began = time.thread_time()
        with suppress(ServiceError):
            read(data)
        return time.thread_time() - began

    seconds = min(once() for _ in range(3))
    tracemalloc.start()
    try:
        with suppress(ServiceError):
            read(data)
        return seconds, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("case", CASES)
def test_the_cost_of_a_refusal_grows_with_its_bytes(case):
    read, size, make = CASES[case]
    small, large = make(size), make(FACTOR * size)
    (seconds, memory), (more_seconds, more_memory) = cost(read, small), cost(read, large)
    growth = max(len(large) / len(small), FACTOR) / FACTOR
    assert more_seconds < MAX_GROWTH * growth * max(seconds, NEGLIGIBLE_S)
    assert more_memory < MAX_GROWTH * growth * max(memory, NEGLIGIBLE_BYTES)
    assert more_memory < MAX_BYTES_PER_BYTE * len(large) + 40_000_000


@pytest.mark.parametrize("case", CASES)
def test_the_document_of_a_refusal_is_short(case):
    read, size, make = CASES[case]
    for error in refusal(read, make(size)):
        assert len(error.field_errors) <= 10
        assert len(document(error)) < 8000


def refusal(read: Reader, data: bytes) -> list[ServiceError]:
    """What is refused of an input, if anything is."""
    try:
        read(data)
    except ServiceError as error:
        return [error]
    return []


def test_decoding_ends_when_its_result_is_not_awaited():
    """A frame that takes long to decode is given up between two pieces of it."""

    class LeftError(Exception):
        pass

    left, began = threading.Event(), time.monotonic()
    buffer = io.BytesIO()
    Image.effect_noise((2048, 2048), 99).convert("RGB").save(buffer, "JPEG", progressive=True)
    whole, checks = buffer.getvalue(), 0

    def check() -> None:
        nonlocal checks
        checks += 1
        if left.is_set():
            raise LeftError

    threading.Timer(0.05, left.set).start()
    with pytest.raises(LeftError):
        decode_frames([whole] * 4, [f"frames[{index}]" for index in range(4)], check)
    assert checks > 1
    assert time.monotonic() - began < 30
