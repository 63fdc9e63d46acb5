"""A server that answers as no server should: one way for each first part of the path.

python -m tests.rollcast.hostile_server    # prints its port
"""

import gzip
import itertools
import json
import socketserver
import sys
import time
import zlib

from tests.rollcast.answers import ANSWERS

TRICKLE_S = 0.05
FLOOD_BYTES = 300 * 10**6
BOMB = gzip.compress(b" " * FLOOD_BYTES, compresslevel=1)
EVENTS = "text/event-stream"


def head(status="200 OK", kind="application/json", length=None, **headers):
    lines = [f"HTTP/1.1 {status}", f"Content-Type: {kind}", "Connection: close"]
    if length is not None:
        lines.append(f"Content-Length: {length}")
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "", ""]).encode()


def whole(body, **headers):
    return [head(length=len(body), **headers), body]


def slowly(parts):
    for part in parts:
        yield part
        time.sleep(TRICKLE_S)


def flood(first, piece):
    yield first
    for _ in range(FLOOD_BYTES // len(piece) + 1):
        yield piece


def started(*parts):
    """Begin a stream of events, and go on with parts without end."""
    return itertools.chain([head(kind=EVENTS)], itertools.cycle(parts))


def with_line(status, line):
    return head(status, length=2).replace(b"\r\n\r\n", b"\r\n" + line + b"\r\n\r\n") + b"{}"


def stream_of(parts):
    return [head(kind=EVENTS), "".join(f"{part}\n\n" for part in parts).encode()]


ALWAYS = {
    "nothing": lambda: [],
    "garbage": lambda: [b"\x00\xff\x16\x03\x01 this is not HTTP\r\n\r\n"],
    "endless-status-line": lambda: flood(b"HTTP/1.1 200 ", b"O" * 65536),
    "no-reason": lambda: [b"HTTP/1.1 200\r\nContent-Length: 2\r\n\r\n{}"],
    "huge-status": lambda: [b"HTTP/1.1 99999 OK\r\n\r\n"],
    "empty": lambda: whole(b""),
    "html": lambda: whole(b"<html>hello</html>", kind="text/html"),
    "gzip-bomb": lambda: whole(BOMB, Content_Encoding="gzip"),
    "announced-huge": lambda: [head(length=FLOOD_BYTES), b"[", b" " * 1000],
    "flood": lambda: flood(head(), b" " * 65536),
    "nested": lambda: whole(b"[" * 200_000),
    "list": lambda: whole(b"[]"),
    "null": lambda: whole(b"null"),
    "number": lambda: whole(b"1e999"),
    "surrogates": lambda: whole(b'{"models": [{"name": "\\ud800", "version": "\\udfff"}]}'),
    "bad-redirect": lambda: [head("302 Found", length=0, Location="http://[::bad/%zz")],
    "host-less-redirect": lambda: [head("307 Temporary", length=0, Location="https:///x")],
    "odd-redirect": lambda: [with_line("301 Moved", b"Location: http://\xfc\xff:99999")],
    "redirect-loop": lambda: [head("301 Moved", length=0, Location="/redirect-loop/models")],
    "odd-id": lambda: [with_line("500 Oops", b"X-Request-ID: \xff\xfe")],
    "retry-never": lambda: [head("429 Too Many", length=2, Retry_After="9" * 400), b"{}"],
    "retry-in-a-billion": lambda: [
        head("503 Down", "application/problem+json", Retry_After="1000000000"),
        json.dumps(
            {"type": "/problems/x", "title": "Down", "status": 503, "detail": "down"}
        ).encode(),
    ],
    "other-status": lambda: [
        head("500 Oops", "application/problem+json"),
        b'{"type": "/problems/x", "title": "t", "status": 200, "detail": "d"}',
    ],
    "informational": lambda: itertools.repeat(b"HTTP/1.1 100 Continue\r\n\r\n", 1_000),
    "slow-head": lambda: slowly(
        itertools.chain([b"HTTP/1.1 200 OK\r\nX: "], itertools.repeat(b"x"))
    ),
    "slow-body": lambda: slowly(itertools.chain([head()], itertools.repeat(b" "))),
    "slow-refusal": lambda: slowly(itertools.chain([head("422 No")], itertools.repeat(b" "))),
    "slow-informational": lambda: slowly(itertools.repeat(b"HTTP/1.1 100 Continue\r\n\r\n")),
    "silent": lambda: slowly(itertools.repeat(b"")),
}
"""Answers that do not depend on the call: parts of bytes by the name of the way."""

SPOILED = {
    "bad-length": lambda body: [head(length="many"), body],
    "short": lambda body: [head(length=len(body) + 1), body],
    "truncated": lambda body: whole(body[: len(body) // 2]),
    "wrong-kind": lambda body: whole(body, kind="image/png"),
    "wrong-charset": lambda body: whole(
        body.decode().encode("utf-16"), kind="application/json; charset=no-such"
    ),
    "not-utf-8": lambda body: whole(body.replace(b'"', b'"\xff', 3)),
    "bad-gzip": lambda body: whole(body, Content_Encoding="gzip"),
    "cut-gzip": lambda body: whole(gzip.compress(body)[:-20], Content_Encoding="gzip"),
    "bad-deflate": lambda body: whole(b"\x78\x9c" + body, Content_Encoding="deflate"),
    "unknown-encoding": lambda body: whole(zlib.compress(body), Content_Encoding="rot13"),
    "bad-chunks": lambda body: [head(Transfer_Encoding="chunked"), b"zz\r\n", body],
    "odd-cookies": lambda body: whole(body[:9], Set_Cookie="\x01=\x02; expires=never; ;;=;"),
}
"""Answers made of the valid body of the call."""

STREAMS = {
    "comments": lambda _: slowly(started(b": on\n\n")),
    "comments-flood": lambda _: started(b": on\n\n" * 999),
    "news-flood": lambda _: started(b"event: news\ndata: 1\n\n" * 99),
    "comments-after-a-step": lambda steps: slowly(
        itertools.chain(stream_of(steps[:1]), itertools.repeat(b": on\n\n"))
    ),
    "one-line": lambda _: flood(head(kind=EVENTS), b"data: " + b"x" * 65536),
    "bad-event": lambda _: stream_of(["event: step\ndata: {"]),
    "bad-error": lambda _: stream_of(["event: error\ndata: {}"]),
    "steps-for-ever": lambda steps: itertools.chain(
        [head(kind=EVENTS)], (numbered(steps[0], index) for index in itertools.count())
    ),
    "done-alone": lambda steps: stream_of(steps[-1:]),
    "twice": lambda steps: stream_of([part for part in steps for _ in range(2)]),
    "step-missing": lambda steps: stream_of(steps[:1] + steps[2:]),
    "last-missing": lambda steps: stream_of(steps[:-2] + steps[-1:]),
    "swapped": lambda steps: stream_of([*steps[1::-1], *steps[2:]]),
    "no-done": lambda steps: stream_of(steps[:-1]),
    "cut": lambda steps: [head(kind=EVENTS), "\n\n".join(steps).encode()[:700]],
}
"""Streams made of the events of a valid one."""


def numbered(step, index):
    part = step.replace('"step":0', f'"step":{index}')
    return part.replace('"time_s":0.0', f'"time_s":{index}.0').encode() + b"\n\n"


def parts(way, body):
    """Return the parts of an answer in place of a valid one."""
    if way in ALWAYS:
        return ALWAYS[way]()
    if way in SPOILED:
        return SPOILED[way](body)
    return STREAMS[way](body.decode().split("\n\n")[:-1])


class Handler(socketserver.StreamRequestHandler):
    def handle(self):
        _, path, _ = self.rfile.readline().decode("latin-1").split(" ", 2)
        length = 0
        while line := self.rfile.readline().strip():
            name, _, value = line.partition(b":")
            if name.lower() == b"content-length":
                length = int(value)
        self.rfile.read(length)
        _, way, rest = path.split("/", 2)
        try:
            for part in parts(way, ANSWERS[f"/{rest}"]):
                self.wfile.write(part)
        except OSError:
            pass  # the client has had enough


class Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    allow_reuse_address = True


if __name__ == "__main__":
    with Server(("127.0.0.1", 0), Handler) as server:
        print(server.server_address[1], flush=True)
        sys.stdin.close()
        server.serve_forever()
